package gluerl;

import java.nio.ByteBuffer;
import java.nio.charset.CharacterCodingException;
import java.nio.charset.StandardCharsets;

/** Reads a header, item by item; anything but what is asked for is a {@link GlueException.Protocol}. */
final class HeaderReader {
    private static final int MAX_HEADER = 4096;
    private static final int MAX_ITEMS = 64;
    private static final long MAX_EXACT = 1L << 53;

    private final ByteBuffer bytes;
    private int left = 1; // items that have not been read

    HeaderReader(byte[] header) {
        if (header.length > MAX_HEADER) {
            throw new GlueException.Protocol(
                    "a header has at most %d bytes, not %d".formatted(MAX_HEADER, header.length));
        }
        bytes = ByteBuffer.wrap(header);
    }

    /** Returns the number of items of an array, whose items come next. */
    int array() {
        int tag = tag();
        long items = (tag & 0xf0) == 0x90 ? tag & 0x0f
                : tag == 0xdc ? unsigned(2)
                : tag == 0xdd ? unsigned(4)
                : fail("an array", tag);
        if (items > MAX_ITEMS) {
            throw new GlueException.Protocol(
                    "an array of a header has at most %d items, not %d".formatted(MAX_ITEMS, items));
        }
        left += (int) items;
        return (int) items;
    }

    long integer() {
        int tag = tag();
        if (!isInteger(tag)) {
            fail("an integer", tag);
        }
        long value = anyInteger(tag);
        if (value < 0) {
            throw new GlueException.Protocol("a header has an integer that is not from 0 to 2^63 - 1");
        }
        return value;
    }

    double real() {
        int tag = tag();
        if (tag == 0xcb) {
            return need(8).getDouble();
        }
        if (tag == 0xca) {
            return need(4).getFloat();
        }
        if (!isInteger(tag)) {
            fail("a float", tag);
        }
        long value = anyInteger(tag);
        if (Math.abs(value) > MAX_EXACT || (tag == 0xcf && value < 0)) {
            throw new GlueException.Protocol("a header has a float that is an integer beyond 2^53");
        }
        return value;
    }

    /** Returns a bool, which may be an integer: all but 0 are true. */
    long flag() {
        int tag = tag();
        if (tag == 0xc2 || tag == 0xc3) {
            return tag - 0xc2;
        }
        if (!isInteger(tag)) {
            fail("a bool", tag);
        }
        return anyInteger(tag);
    }

    String text() {
        int tag = tag();
        long size = (tag & 0xe0) == 0xa0 ? tag & 0x1f
                : tag == 0xd9 ? unsigned(1)
                : tag == 0xda ? unsigned(2)
                : tag == 0xdb ? unsigned(4)
                : fail("a text", tag);
        need(size);
        ByteBuffer utf8 = bytes.slice(bytes.position(), (int) size);
        bytes.position(bytes.position() + (int) size);
        try {
            return StandardCharsets.UTF_8.newDecoder().decode(utf8).toString();
        } catch (CharacterCodingException error) {
            throw new GlueException.Protocol("a text of a header is not UTF-8");
        }
    }

    /** Checks that nothing follows. */
    void end() {
        if (left != 0 || bytes.hasRemaining()) {
            throw new GlueException.Protocol("a header has other items than its kind says");
        }
    }

    private int tag() {
        if (left == 0) {
            throw new GlueException.Protocol("a header has fewer items than its kind says");
        }
        left -= 1;
        return need(1).get() & 0xff;
    }

    private static boolean isInteger(int tag) {
        return tag < 0x80 || tag >= 0xe0 || (tag >= 0xcc && tag <= 0xd3);
    }

    /** Returns an integer; one of 2^63 or more, which only the tag 0xcf has, is negative. */
    private long anyInteger(int tag) {
        return switch (tag) {
            case 0xcc -> unsigned(1);
            case 0xcd -> unsigned(2);
            case 0xce -> unsigned(4);
            case 0xcf, 0xd3 -> need(8).getLong();
            case 0xd0 -> need(1).get();
            case 0xd1 -> need(2).getShort();
            case 0xd2 -> need(4).getInt();
            default -> (byte) tag;
        };
    }

    private long unsigned(int size) {
        need(size);
        long value = 0;
        for (int i = 0; i < size; i++) {
            value = value << 8 | (bytes.get() & 0xff);
        }
        return value;
    }

    private ByteBuffer need(long size) {
        if (size > bytes.remaining()) {
            throw new GlueException.Protocol("a header ends in the middle of an item");
        }
        return bytes;
    }

    private static long fail(String expected, int tag) {
        throw new GlueException.Protocol("a header has %s where the byte 0x%02x was received".formatted(expected, tag));
    }
}
