package gluerl;

import java.io.ByteArrayOutputStream;
import java.nio.charset.StandardCharsets;

/** Writes msgpack, item by item: a header, which is an array, or extras, which are a map. */
final class Packer {
    private final ByteArrayOutputStream bytes = new ByteArrayOutputStream(64);

    Packer array(int items) {
        if (items < 16) {
            bytes.write(0x90 | items);
        } else {
            bytes.write(0xdc);
            bigEndian(items, 2);
        }
        return this;
    }

    /** Begins a map of up to 65,535 items, each a key and a value. */
    Packer map(int items) {
        if (items < 16) {
            bytes.write(0x80 | items);
        } else {
            bytes.write(0xde);
            bigEndian(items, 2);
        }
        return this;
    }

    /** Writes an integer from 0 to 2^63 - 1 in as few bytes as there are. */
    Packer integer(long value) {
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

    Packer signed(long value) {
        if (value >= 0) {
            return integer(value);
        }
        if (value >= -32) {
            bytes.write((int) value);
            return this;
        }
        int power = value >= Byte.MIN_VALUE ? 0 : value >= Short.MIN_VALUE ? 1 : value >= Integer.MIN_VALUE ? 2 : 3;
        bytes.write(0xd0 + power);
        return bigEndian(value, 1 << power);
    }

    Packer real(double value) {
        bytes.write(0xcb);
        return bigEndian(Double.doubleToRawLongBits(value), 8);
    }

    Packer truth(boolean value) {
        bytes.write(value ? 0xc3 : 0xc2);
        return this;
    }

    Packer nil() {
        bytes.write(0xc0);
        return this;
    }

    Packer text(String value) {
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

    /** Writes up to 65,535 bytes. */
    Packer binary(byte[] value) {
        int power = value.length < 0x100 ? 0 : 1;
        bytes.write(0xc4 + power);
        bigEndian(value.length, 1 << power);
        bytes.writeBytes(value);
        return this;
    }

    byte[] finish() {
        return bytes.toByteArray();
    }

    private Packer bigEndian(long value, int size) {
        for (int shift = 8 * size - 8; shift >= 0; shift -= 8) {
            bytes.write((int) (value >> shift));
        }
        return this;
    }
}
