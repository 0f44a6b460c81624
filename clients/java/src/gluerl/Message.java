package gluerl;

import java.nio.ByteBuffer;
import java.nio.charset.StandardCharsets;

/**
 * A message from the hub, checked.
 *
 * @param kind its kind, or null if that is not known
 * @param code the code of its kind
 * @param session the name of the session
 * @param seq the sequence number
 * @param scalars each a Long, Double, Boolean, String or String[], as the kind says; an end is a Boolean or CUT_OFF
 * @param body the body, or null
 */
record Message(Kind kind, long code, String session, long seq, Object[] scalars, byte[] body) {
    static final int MAX_BODY = 16777216;

    /** Instead of a Boolean, that an episode was cut off in a state that is not terminal. */
    static final Long CUT_OFF = 2L;

    private static final int MAX_HEADER = 4096;
    static final int MAX_SESSION = 255;
    private static final Object[] NO_SCALARS = {};

    /** Returns the message that frames stand for; a {@link GlueException.Protocol} says what is wrong with them. */
    static Message decode(byte[][] frames) {
        if (frames[0].length > MAX_HEADER) {
            throw new GlueException.Protocol(
                    "a header has at most %d bytes, not %d".formatted(MAX_HEADER, frames[0].length));
        }
        Unpacker reader = new Unpacker(frames[0], "a header");
        int items = reader.array();
        long code = reader.integer();
        String session = reader.text();
        long seq = reader.integer();
        if (session.codePointCount(0, session.length()) > MAX_SESSION) {
            throw new GlueException.Protocol("the name of a session has more than " + MAX_SESSION + " characters");
        }
        Kind kind = Kind.fromHub(code);
        byte[] body = frames.length > 1 ? frames[1] : null;
        if (kind == null) {
            return new Message(null, code, session, seq, NO_SCALARS, body);
        }
        int count = items > 3 + kind.neededFromHub ? kind.fromHub.length() : kind.neededFromHub;
        Object[] scalars = count == 0 ? NO_SCALARS : new Object[count];
        for (int i = 0; i < count; i++) {
            scalars[i] = switch (kind.fromHub.charAt(i)) {
                case 'i' -> (Object) reader.integer();
                case 'f', 'F' -> reader.real();
                case 'b' -> reader.flag() != 0;
                case 'e' -> endOf(reader.flag());
                case 'T' -> texts(reader);
                default -> reader.text();
            };
        }
        reader.end();
        check(kind, body);
        return new Message(kind, code, session, seq, scalars, body);
    }

    /** Returns the frames of a message to the hub. */
    static byte[][] encode(Kind kind, String session, long seq, byte[] body, Object... scalars) {
        Packer header = new Packer().array(3 + scalars.length);
        header.integer(kind.code).text(session).integer(seq);
        for (int i = 0; i < scalars.length; i++) {
            Object value = scalars[i];
            switch (kind.toHub.charAt(i)) {
                case 'i' -> header.integer((Long) value);
                case 'f' -> header.real((Double) value);
                case 'b', 'e' -> {
                    if (CUT_OFF.equals(value)) {
                        header.integer(CUT_OFF);
                    } else {
                        header.truth((Boolean) value);
                    }
                }
                case 't' -> header.text((String) value);
                case 'x' -> header.binary((byte[]) value);
                case 'I' -> {
                    long[] numbers = (long[]) value;
                    header.array(numbers.length);
                    for (long number : numbers) {
                        header.integer(number);
                    }
                }
                case 'T' -> {
                    String[] texts = (String[]) value;
                    header.array(texts.length);
                    for (String text : texts) {
                        header.text(text);
                    }
                }
                default -> {
                    if (value == null) {
                        header.nil();
                    } else {
                        header.integer((Long) value);
                    }
                }
            }
        }
        return body == null ? new byte[][] {header.finish()} : new byte[][] {header.finish(), body};
    }

    /** Returns whether a text has 1 to {@code most} characters, all printable. */
    static boolean isName(String text, int most) {
        int length = text.codePointCount(0, text.length());
        return length >= 1 && length <= most && text.codePoints().noneMatch(c -> switch (Character.getType(c)) {
            case Character.CONTROL, Character.FORMAT, Character.SURROGATE, Character.PRIVATE_USE, Character.UNASSIGNED,
                    Character.LINE_SEPARATOR, Character.PARAGRAPH_SEPARATOR -> true;
            default -> false;
        });
    }

    static byte[] utf8(String text) {
        return text.getBytes(StandardCharsets.UTF_8);
    }

    String text() {
        return new String(body, StandardCharsets.UTF_8);
    }

    /** Returns the body for reading, where it begins. */
    ByteBuffer reader() {
        return AbstractType.littleEndian(body);
    }

    double real(int scalar) {
        return (Double) scalars[scalar];
    }

    boolean truth(int scalar) {
        return !Boolean.FALSE.equals(scalars[scalar]);
    }

    boolean isCutOff(int scalar) {
        return CUT_OFF.equals(scalars[scalar]);
    }

    long integer(int scalar) {
        return (Long) scalars[scalar];
    }

    String text(int scalar) {
        return (String) scalars[scalar];
    }

    private static String[] texts(Unpacker reader) {
        String[] texts = new String[reader.array()];
        for (int i = 0; i < texts.length; i++) {
            texts[i] = reader.text();
        }
        return texts;
    }

    private static Object endOf(long flag) {
        return flag == CUT_OFF ? CUT_OFF : (Object) (flag != 0);
    }

    private static void check(Kind kind, byte[] body) {
        if ((body == null) != (kind.bodyFromHub == Kind.Body.NONE)) {
            throw new GlueException.Protocol(
                    kind + (body == null ? " has a body, and came without one" : " has no body, and came with one"));
        }
        int end = switch (kind.bodyFromHub) {
            case ACTION -> AbstractType.endOf(body, 0, false, false);
            case SEEN -> AbstractType.endOf(body, 0, true, false);
            case OBSERVATION -> AbstractType.endOf(body, 0, true, true);
            case BOTH -> AbstractType.endOf(body, AbstractType.endOf(body, 0, true, true), false, false);
            case NONE, TEXT, BYTES -> -1;
        };
        if (end >= 0 && end != body.length) {
            throw new GlueException.Protocol("the body of " + kind + " is longer than its counts say");
        }
    }
}
