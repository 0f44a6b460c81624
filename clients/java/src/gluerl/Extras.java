package gluerl;

import java.util.Collections;
import java.util.LinkedHashMap;
import java.util.Map;
import java.util.function.ToIntFunction;

/** Extras as they cross the wire: one map of msgpack, in which nothing is nested. */
final class Extras {
    private static final int MAX_NAME = 64;
    private static final byte[] NONE = {};

    private Extras() {}

    /** Returns the bytes of extras, of which there are none if there are no extras. */
    static byte[] pack(Map<String, ?> extras) {
        if (extras.isEmpty()) {
            return NONE;
        }
        if (extras.size() > Unpacker.MAX_ITEMS) {
            throw new IllegalArgumentException("an observation has at most 64 extras, not " + extras.size());
        }
        Packer packer = new Packer().map(extras.size());
        extras.forEach((name, value) -> {
            if (!Message.isName(name, MAX_NAME)) {
                throw new IllegalArgumentException(
                        "the name of an extra has 1 to 64 printable characters, not \"%s\"".formatted(name));
            }
            packer.text(name);
            pack(packer, name, value);
        });
        byte[] packed = packer.finish();
        if (packed.length > Observation.MAX_BESIDE) {
            throw new IllegalArgumentException(
                    "the extras of an observation have at most 65535 bytes, not " + packed.length);
        }
        return packed;
    }

    private static void pack(Packer packer, String name, Object value) {
        if (value instanceof Integer || value instanceof Long) {
            packer.signed(((Number) value).longValue());
        } else if (value instanceof Float || value instanceof Double) {
            packer.real(((Number) value).doubleValue());
        } else if (value instanceof String text) {
            packer.text(fitting(name, text, String::length));
        } else if (value instanceof byte[] bytes) {
            packer.binary(fitting(name, bytes, some -> some.length));
        } else if (value instanceof long[] numbers) {
            packer.array(fitting(name, numbers, some -> some.length).length);
            for (long number : numbers) {
                packer.signed(number);
            }
        } else if (value instanceof double[] numbers) {
            packer.array(fitting(name, numbers, some -> some.length).length);
            for (double number : numbers) {
                packer.real(number);
            }
        } else {
            throw new IllegalArgumentException("an extra is an integer, a floating point number, a String, a byte[], a "
                    + "long[] or a double[]; %s is %s".formatted(name, value == null ? "null" : value.getClass()));
        }
    }

    /** Returns what is not certainly too long: its length would fit no header of msgpack. */
    private static <T> T fitting(String name, T value, ToIntFunction<T> length) {
        if (length.applyAsInt(value) > Observation.MAX_BESIDE) {
            throw new IllegalArgumentException(
                    "the extras of an observation have at most 65535 bytes, and %s alone has more".formatted(name));
        }
        return value;
    }

    /** Returns the extras that were received; they cannot be changed. */
    static Map<String, Object> unpack(byte[] packed) {
        Unpacker unpacker = new Unpacker(packed, "a map of extras");
        Map<String, Object> extras = new LinkedHashMap<>();
        for (int left = unpacker.map(); left > 0; left--) {
            String name = unpacker.text();
            if (!Message.isName(name, MAX_NAME)) {
                throw unpacker.wrong("has a name that is not 1 to 64 printable characters");
            }
            if (extras.put(name, unpack(unpacker)) != null) {
                throw unpacker.wrong("has the name " + name + " twice");
            }
        }
        unpacker.end();
        return Collections.unmodifiableMap(extras);
    }

    private static Object unpack(Unpacker unpacker) {
        return switch (unpacker.next()) {
            case INTEGER -> (Object) unpacker.signed();
            case REAL -> unpacker.real();
            case TEXT -> unpacker.text();
            case BINARY -> unpacker.binary();
            case ARRAY -> array(unpacker);
            default -> throw unpacker.wrong("has a value that is no number, text, bytes or array");
        };
    }

    private static Object array(Unpacker unpacker) {
        // No item is shorter than a byte, so nothing large is allocated for a small message.
        int count = unpacker.array(unpacker.remaining());
        boolean real = count > 0 && unpacker.next() == Unpacker.Type.REAL;
        long[] integers = new long[real ? 0 : count];
        double[] reals = new double[real ? count : 0];
        for (int i = 0; i < count; i++) {
            if (unpacker.next() != (real ? Unpacker.Type.REAL : Unpacker.Type.INTEGER)) {
                throw unpacker.wrong("has an array that is neither of integers nor of floats");
            }
            if (real) {
                reals[i] = unpacker.real();
            } else {
                integers[i] = unpacker.signed();
            }
        }
        return real ? reals : integers;
    }
}
