package gluerl;

import java.io.ByteArrayOutputStream;
import java.nio.charset.StandardCharsets;

/** Writes a header, a msgpack array, item by item. */
final class HeaderWriter {
    private final ByteArrayOutputStream bytes = new ByteArrayOutputStream(64);

    HeaderWriter array(int items) {
        if (items < 16) {
            bytes.write(0x90 | items);
        } else {
            bytes.write(0xdc);
            bigEndian(items, 2);
        }
        return this;
    }

    /** Writes an integer from 0 to 2^63 - 1 in as few bytes as there are. */
    HeaderWriter integer(long value) {
        if (value < 0) {
            throw new IllegalArgumentException("integers are from 0 to 2^63 - 1, not " + value);
        }
        if (value < 0x80) {
            bytes.write((int) value);
        } else {
            int power = value < 0x100 ? 0 : value < 0x10000 ? 1 : value < 0x100000000L ? 2 : 3;
            bytes.write(0xcc + power);
            bigEndian(value, 1 << power);
        }
        return this;
    }

    HeaderWriter real(double value) {
        bytes.write(0xcb);
        return bigEndian(Double.doubleToRawLongBits(value), 8);
    }

    HeaderWriter truth(boolean value) {
        bytes.write(value ? 0xc3 : 0xc2);
        return this;
    }

    HeaderWriter nil() {
        bytes.write(0xc0);
        return this;
    }

    HeaderWriter text(String value) {
        byte[] utf8 = value.getBytes(StandardCharsets.UTF_8);
        if (utf8.length < 32) {
            bytes.write(0xa0 | utf8.length);
        } else if (utf8.length < 0x100) {
            bytes.write(0xd9);
            bigEndian(utf8.length, 1);
        } else {
            bytes.write(0xda);
            bigEndian(utf8.length, 2);
        }
        bytes.writeBytes(utf8);
        return this;
    }

    /** Writes up to 255 bytes. */
    HeaderWriter binary(byte[] value) {
        bytes.write(0xc4);
        bytes.write(value.length);
        bytes.writeBytes(value);
        return this;
    }

    byte[] finish() {
        return bytes.toByteArray();
    }

    private HeaderWriter bigEndian(long value, int size) {
        for (int shift = 8 * size - 8; shift >= 0; shift -= 8) {
            bytes.write((int) (value >> shift));
        }
        return this;
    }
}
