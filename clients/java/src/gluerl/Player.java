package gluerl;

import java.util.ArrayList;
import java.util.Arrays;
import java.util.List;

/** An agent or environment in its session: each call is carried out once, however often it comes. */
final class Player {
    private final String role;
    private final String name;
    private final Calls calls;
    private final Link link;
    private long lastSeq;
    private Message lastCall;
    private byte[][] lastAnswer;

    Player(String role, Calls calls, Object player, Options options) {
        List<String> capabilities = new ArrayList<>();
        if (player instanceof Saveable) {
            capabilities.add("save");
        }
        if (player instanceof Measured) {
            capabilities.add("metrics");
        }
        if (player instanceof Seedable) {
            capabilities.add("seed");
        }
        if (player instanceof Paced) {
            capabilities.add("pace");
        }
        capabilities.add("mask");
        if (player instanceof Environment) {
            capabilities.addAll(List.of("extras", "truncate"));
        }
        this.role = role;
        this.name = options.name();
        this.calls = calls;
        link = new Link(role, options, capabilities.toArray(String[]::new));
    }

    /** Answers the hub's calls until it says goodbye; returns its reason. */
    String serve() {
        String reason = "interrupted";
        try {
            while (true) {
                Message message = link.receive();
                if (message == null) {
                    continue;
                }
                switch (message.kind()) {
                    case WELCOME -> {
                        // The last call is kept: if it comes again, it is the same hub, which never had the answer.
                        if (!message.truth(1)) {
                            lastSeq = 0;
                        }
                    }
                    case ERROR -> link.log("the hub says: " + message.text(1));
                    default -> {
                        if (link.isWelcomed()) {
                            answer(message);
                        }
                    }
                }
            }
        } catch (GlueException.HubClosed goodbye) {
            return goodbye.getMessage();
        } catch (GlueException error) {
            reason = error.getMessage();
            throw error;
        } finally {
            link.close(reason);
        }
    }

    private void answer(Message call) {
        if (call.seq() < lastSeq) {
            return;
        }
        if (call.seq() > lastSeq && !isSame(call, lastCall)) {
            lastAnswer = carryOut(call);
            lastCall = call;
        }
        lastSeq = call.seq();
        link.send(lastAnswer);
    }

    private byte[][] carryOut(Message call) {
        try {
            Calls.Result result = calls.call(call);
            if (result == null) {
                return link.error(call.seq(), "unknown-kind", "this " + role + " does not know " + call.kind());
            }
            return link.encode(call.kind(), call.seq(), result.body(), result.scalars());
        } catch (Exception | AssertionError | StackOverflowError error) {
            String text = error.getMessage() == null ? error.toString() : error.getMessage();
            link.send(link.error(call.seq(), "exception", text));
            throw new GlueException.PlayerThrew(
                    "%s %s threw in %s: %s".formatted(role, name, call.kind(), error), error);
        }
    }

    private static boolean isSame(Message one, Message other) {
        return other != null
                && one.seq() == other.seq()
                && one.kind() == other.kind()
                && Arrays.equals(one.scalars(), other.scalars())
                && Arrays.equals(one.body(), other.body());
    }
}
