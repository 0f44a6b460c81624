package gluerl;

import java.nio.charset.StandardCharsets;
import java.security.SecureRandom;
import java.util.List;

/** A peer's place in a session: greetings, heartbeats, and reconnecting after a break. */
final class Link {
    private static final long DEFAULT_HEARTBEAT_MS = 1000;
    private static final long DEFAULT_TIMEOUT_MS = 5000;
    private static final long MAX_HEARTBEAT_MS = 60_000;
    private static final int MAX_TEXT = 1000;
    private static final String CODEC = "Java " + Runtime.version().feature();

    private final String role;
    private final Options options;
    private final String[] capabilities;
    private final byte[] instance = new byte[16];
    private final Dealer dealer;
    private long heartbeat = DEFAULT_HEARTBEAT_MS;
    private long timeout = DEFAULT_TIMEOUT_MS;
    private int maxBody = Message.MAX_BODY;
    private boolean takesMasks; // the hub; an older one does not
    private boolean takesExtras;
    private int greeted; // the connection that was greeted last; also the seq of that HELLO
    private boolean welcomed; // over that connection
    private boolean waiting; // for a hub, and has said so
    private final long started = System.nanoTime();

    Link(String role, Options options, String... capabilities) {
        checkSession(options.session());
        if (isSet("GLUE_KEY") || isSet("GLUE_HUB_KEY")) {
            throw new GlueException.Config(
                    "this library has no encryption: unset GLUE_KEY and GLUE_HUB_KEY, or write in C++ or Python");
        }
        this.role = role;
        this.options = options;
        this.capabilities = capabilities;
        new SecureRandom().nextBytes(instance);
        dealer = new Dealer(options.hub(), options.log());
    }

    /** Returns whether the hub has welcomed us over the latest connection. */
    boolean isWelcomed() {
        return welcomed && dealer.isReady() && dealer.connections() == greeted;
    }

    String session() {
        return options.session();
    }

    void log(String line) {
        options.log().accept(line);
    }

    /** Returns the frames of a call's answer, or of a request, with as much beside an observation as the hub takes. */
    byte[][] encode(Kind kind, long seq, byte[] body, Object... scalars) {
        byte[] taken = switch (kind.bodyToHub) {
            case OBSERVATION -> Observation.cut(body, takesMasks, takesExtras);
            case SEEN -> Observation.cut(body, takesMasks, false);
            default -> body;
        };
        if (taken != null && taken.length > maxBody) {
            throw new IllegalArgumentException(
                    "a body has %d bytes, and the hub takes %d".formatted(taken.length, maxBody));
        }
        return Message.encode(kind, session(), seq, taken, scalars);
    }

    /** Sends what {@link #encode} made. */
    void send(byte[][] frames) {
        dealer.send(frames);
    }

    /**
     * Returns the next call, reply, ERROR, NOTICE, or WELCOME over the latest connection; null if there is none for a
     * heartbeat.
     */
    Message receive() {
        byte[][] frames;
        Message message;
        try {
            frames = dealer.receive(heartbeat, timeout);
            if (frames == null) {
                idle();
                return null;
            }
            message = Message.decode(frames);
        } catch (GlueException.Protocol error) {
            throw new GlueException.Protocol(
                    "the hub at %s broke the protocol: %s".formatted(options.hub(), error.getMessage()));
        }
        if (!message.session().equals(options.session())) {
            if (message.kind() == Kind.ERROR && message.session().isEmpty()) {
                log("the hub says: " + message.text(1));
            }
            return null;
        }
        if (message.kind() == null) {
            send(error(message.seq(), "unknown-kind", "this " + role + " does not know kind " + message.code()));
            return null;
        }
        return control(message);
    }

    /** Says goodbye, and leaves. */
    void close(String reason) {
        if (isWelcomed()) {
            send(Message.encode(Kind.GOODBYE, session(), 0, null, clip(reason)));
        }
        dealer.close();
    }

    /** Returns the ERROR with which a player answers. */
    byte[][] error(long seq, String code, String text) {
        return Message.encode(Kind.ERROR, session(), seq, null, code, clip(text));
    }

    private Message control(Message message) {
        switch (message.kind()) {
            case HEARTBEAT:
                return null;
            case WELCOME:
                return welcome(message) ? message : null;
            case REFUSE:
                throw new GlueException.Refused(
                        "the hub at %s refused this %s: %s".formatted(options.hub(), role, message.text(1)));
            case GOODBYE:
                welcomed = false; // a goodbye has no answer
                throw new GlueException.HubClosed(message.text(0));
            case ERROR:
                if (!message.text(0).equals("unknown-peer")) {
                    return message;
                }
                // While a HELLO is unanswered, this error is about something sent before it.
                if (welcomed) {
                    greet();
                }
                return null;
            default:
                return message;
        }
    }

    private void greet() {
        welcomed = false;
        greeted = dealer.connections();
        send(Message.encode(Kind.HELLO, session(), greeted, null,
                new long[] {1}, role, instance, options.name(), CODEC, capabilities));
    }

    private boolean welcome(Message message) {
        // A WELCOME to an earlier HELLO may be another hub's; a second one to the same HELLO says nothing new.
        if (message.seq() != greeted || welcomed) {
            return false;
        }
        if (message.integer(0) != 1) {
            throw new GlueException.Protocol("version %d was chosen, and 1 was offered".formatted(message.integer(0)));
        }
        heartbeat = Math.min(millis(message.real(2)), MAX_HEARTBEAT_MS);
        timeout = Math.max(millis(message.real(3)), heartbeat);
        maxBody = (int) Math.min(message.integer(4), Message.MAX_BODY);
        List<String> capabilities = message.scalars().length > 5 ? List.of((String[]) message.scalars()[5]) : List.of();
        takesMasks = capabilities.contains("mask");
        takesExtras = capabilities.contains("extras");
        if (waiting) {
            log("the hub at " + options.hub() + " is there");
        }
        waiting = false;
        welcomed = true;
        return true;
    }

    private void idle() {
        if (!dealer.isReady()) {
            welcomed = false;
        } else if (dealer.connections() != greeted) {
            greet();
            return;
        }
        if (welcomed) {
            send(Message.encode(Kind.HEARTBEAT, session(), 0, null));
        } else if (!waiting && System.nanoTime() - started > heartbeat * 1_000_000) {
            waiting = true;
            log("no hub answers at %s yet; waiting for one (glue-hub and glue-experiment start one)"
                    .formatted(options.hub()));
        }
    }

    /** Returns a time in which one can wait, whatever a hub says; what is no number becomes the least. */
    private static long millis(double seconds) {
        return seconds > 0.01 ? (long) (1000 * seconds) : 10;
    }

    private static boolean isSet(String variable) {
        return !System.getenv().getOrDefault(variable, "").isEmpty();
    }

    private static void checkSession(String session) {
        if (!Message.isName(session, Message.MAX_SESSION)) {
            throw new GlueException.Config(
                    "the name of a session has 1 to 255 printable characters, not \"%s\"".formatted(session));
        }
    }

    /** Returns one line of at most a thousand bytes. */
    private static String clip(String text) {
        String line = text.strip().replaceAll("\\s+", " ");
        while (line.getBytes(StandardCharsets.UTF_8).length > MAX_TEXT) {
            line = line.substring(0, Math.min(line.length() - 1, MAX_TEXT));
        }
        return line;
    }
}
