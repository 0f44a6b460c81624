package gluerl;

import java.nio.ByteBuffer;
import java.nio.charset.StandardCharsets;
import java.util.Arrays;

/** Takes what a hub sends in pieces of any size, and makes messages and commands of it: ZMTP 3.1, NULL. */
final class FrameReader {
    static final int MORE = 1;
    static final int LONG = 2;
    static final int COMMAND = 4;

    private static final int GREETING_SIZE = 64;
    private static final int MAX_HEADER = 4096;
    private static final int MAX_COMMAND = 4096;
    private static final int MAX_FRAME = 2 * Message.MAX_BODY; // an observation and an action
    private static final int SMALL = 1 << 16;

    private byte[] buffer = new byte[SMALL];
    private int start;
    private int end;
    private boolean greeted;
    private byte[] header; // the first frame of a message of two

    /** What comes out: a greeting that was right, a command, or a message. */
    sealed interface Item {}

    record Greeting() implements Item {}

    record Command(String name, byte[] data) implements Item {}

    record Frames(byte[][] frames) implements Item {}

    /** Returns the 64 bytes with which either side begins. */
    static byte[] greeting() {
        byte[] greeting = new byte[GREETING_SIZE];
        greeting[0] = (byte) 0xff;
        greeting[9] = 0x7f;
        greeting[10] = 3;
        greeting[11] = 1;
        byte[] mechanism = "NULL".getBytes(StandardCharsets.US_ASCII);
        System.arraycopy(mechanism, 0, greeting, 12, mechanism.length);
        return greeting;
    }

    /** Returns the command with which a DEALER follows the greeting. */
    static byte[] ready() {
        String data = "\5READY\13Socket-Type\0\0\0\6DEALER\10Identity\0\0\0\0";
        return frames(COMMAND, data.getBytes(StandardCharsets.ISO_8859_1));
    }

    /** Returns frames with flags and lengths before them; all but the last have the flag MORE as well. */
    static byte[] frames(int flags, byte[]... frames) {
        int size = 0;
        for (byte[] frame : frames) {
            size += (frame.length < 256 ? 2 : 9) + frame.length;
        }
        ByteBuffer bytes = ByteBuffer.allocate(size);
        for (int i = 0; i < frames.length; i++) {
            int all = flags | (i < frames.length - 1 ? MORE : 0);
            if (frames[i].length < 256) {
                bytes.put((byte) all).put((byte) frames[i].length);
            } else {
                bytes.put((byte) (all | LONG)).putLong(frames[i].length);
            }
            bytes.put(frames[i]);
        }
        return bytes.array();
    }

    /** Returns where to put the next bytes; {@link #received} says how many were put. */
    ByteBuffer room() {
        if (start == end) {
            start = end = 0;
            if (buffer.length > SMALL) {
                buffer = new byte[SMALL];
            }
        }
        if (end == buffer.length) {
            // The bytes here belong to a frame whose length has been checked.
            byte[] target = start >= buffer.length / 2 ? buffer : new byte[2 * buffer.length];
            System.arraycopy(buffer, start, target, 0, end - start);
            buffer = target;
            end -= start;
            start = 0;
        }
        return ByteBuffer.wrap(buffer, end, buffer.length - end);
    }

    void received(int count) {
        end += count;
    }

    /** Returns what comes next, or null if more bytes are needed for it. */
    Item next() {
        if (!greeted) {
            return end - start < GREETING_SIZE ? null : greet();
        }
        while (true) {
            if (end - start < 2) {
                return null;
            }
            int flags = buffer[start];
            int head = (flags & LONG) != 0 ? 9 : 2;
            if (end - start < head) {
                return null;
            }
            long length = head == 2
                    ? buffer[start + 1] & 0xff
                    : ByteBuffer.wrap(buffer, start + 1, 8).getLong();
            check(flags, length);
            if (end - start - head < length) {
                return null;
            }
            int from = start + head;
            start = from + (int) length;
            byte[] frame = Arrays.copyOfRange(buffer, from, start);
            if ((flags & COMMAND) != 0) {
                return command(frame);
            }
            if ((flags & MORE) == 0) {
                byte[][] frames = header == null ? new byte[][] {frame} : new byte[][] {header, frame};
                header = null;
                return new Frames(frames);
            }
            header = frame;
        }
    }

    private Item greet() {
        if (buffer[0] != (byte) 0xff || (buffer[9] & 1) == 0 || buffer[10] < 3) {
            throw new GlueException.Protocol("it does not speak ZMTP 3: is this the address of a hub?");
        }
        String mechanism = new String(buffer, 12, 20, StandardCharsets.ISO_8859_1).trim();
        if (!mechanism.equals("NULL")) {
            throw new GlueException.Config(
                    "the hub wants " + mechanism + ", and this library has no encryption: use another of its addresses");
        }
        start = GREETING_SIZE;
        greeted = true;
        return new Greeting();
    }

    private void check(int flags, long length) {
        boolean command = (flags & COMMAND) != 0;
        boolean more = (flags & MORE) != 0;
        if (flags < 0 || flags > (MORE | LONG | COMMAND) || (command && more)) {
            throw new GlueException.Protocol("a frame has the flags %d, which do not exist".formatted(flags & 0xff));
        }
        if (header != null && more) {
            throw new GlueException.Protocol("a message has more than two frames");
        }
        int most = command ? MAX_COMMAND : header == null ? MAX_HEADER : MAX_FRAME;
        if (length < 0 || length > most) {
            throw new GlueException.Protocol("a frame has %s bytes, and %d are allowed"
                    .formatted(Long.toUnsignedString(length), most));
        }
    }

    private static Item command(byte[] data) {
        int end = data.length == 0 ? 0 : Math.min(1 + (data[0] & 0xff), data.length);
        String name = end == 0 ? "" : new String(data, 1, end - 1, StandardCharsets.ISO_8859_1);
        return new Command(name, Arrays.copyOfRange(data, end, data.length));
    }
}
