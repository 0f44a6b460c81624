package gluerl;

import java.nio.ByteBuffer;
import java.nio.charset.CharacterCodingException;
import java.nio.charset.StandardCharsets;

/** Reads msgpack, item by item; anything but what is asked for is a {@link GlueException.Protocol}. */
final class Unpacker {
    static final int MAX_ITEMS = 64;

    private static final long MAX_EXACT = 1L << 53;

    enum Type {
        INTEGER,
        REAL,
        TEXT,
        BINARY,
        ARRAY,
        OTHER
    }

    private final ByteBuffer bytes;
    private final String what;
    private int left = 1; // items that have not been read

    /** Reads {@code bytes}, which errors call {@code what}. */
    Unpacker(byte[] bytes, String what) {
        this.bytes = ByteBuffer.wrap(bytes);
        this.what = what;
    }

    /** Returns the type of the next item, and reads nothing. */
    Type next() {
        int tag = bytes.hasRemaining() ? bytes.get(bytes.position()) & 0xff : 0xc1;
        return isInteger(tag) ? Type.INTEGER
                : tag == 0xca || tag == 0xcb ? Type.REAL
                : (tag & 0xe0) == 0xa0 || (tag >= 0xd9 && tag <= 0xdb) ? Type.TEXT
                : tag >= 0xc4 && tag <= 0xc6 ? Type.BINARY
                : (tag & 0xf0) == 0x90 || tag == 0xdc || tag == 0xdd ? Type.ARRAY
                : Type.OTHER;
    }

    /** Returns the number of items of an array, whose items come next. */
    int array() {
        return array(MAX_ITEMS);
    }

    int array(int most) {
        int tag = tag();
        long items = (tag & 0xf0) == 0x90 ? tag & 0x0f
                : tag == 0xdc ? unsigned(2)
                : tag == 0xdd ? unsigned(4)
                : fail("an array", tag);
        return items(items, most, 1);
    }

    /** Returns the number of items of a map; of each the key comes next, and then the value. */
    int map() {
        int tag = tag();
        long items = (tag & 0xf0) == 0x80 ? tag & 0x0f
                : tag == 0xde ? unsigned(2)
                : tag == 0xdf ? unsigned(4)
                : fail("a map", tag);
        return items(items, MAX_ITEMS, 2);
    }

    /** Returns how many bytes have not been read, which is no less than the number of items. */
    int remaining() {
        return bytes.remaining();
    }

    long integer() {
        int tag = tag();
        if (!isInteger(tag)) {
            fail("an integer", tag);
        }
        long value = anyInteger(tag);
        if (value < 0) {
            throw wrong("has an integer that is not from 0 to 2^63 - 1");
        }
        return value;
    }

    long signed() {
        int tag = tag();
        if (!isInteger(tag)) {
            fail("an integer", tag);
        }
        long value = anyInteger(tag);
        if (value < 0 && tag == 0xcf) {
            throw wrong("has an integer beyond 2^63 - 1");
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
        if (value > MAX_EXACT || value < -MAX_EXACT || (tag == 0xcf && value < 0)) {
            throw wrong("has a float that is an integer beyond 2^53");
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
            throw wrong("has a text that is not UTF-8");
        }
    }

    byte[] binary() {
        int tag = tag();
        long size = tag >= 0xc4 && tag <= 0xc6 ? unsigned(1 << (tag - 0xc4)) : fail("bytes", tag);
        need(size);
        byte[] value = new byte[(int) size];
        bytes.get(value);
        return value;
    }

    /** Checks that nothing follows. */
    void end() {
        if (left != 0 || bytes.hasRemaining()) {
            throw wrong("has more items than it should have");
        }
    }

    GlueException.Protocol wrong(String text) {
        return new GlueException.Protocol(what + " " + text);
    }

    private int items(long items, int most, int each) {
        if (items > most) {
            throw wrong("has an array or a map of %d items, and at most %d are allowed".formatted(items, most));
        }
        left += each * (int) items;
        return (int) items;
    }

    private int tag() {
        if (left == 0) {
            throw wrong("has fewer items than it should have");
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
            throw wrong("ends in the middle of an item");
        }
        return bytes;
    }

    private long fail(String expected, int tag) {
        throw wrong("has the byte 0x%02x where %s was expected".formatted(tag, expected));
    }
}
