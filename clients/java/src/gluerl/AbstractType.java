package gluerl;

import java.nio.ByteBuffer;
import java.nio.ByteOrder;
import java.util.Arrays;

/** RL-Glue's abstract type: three runs of numbers, each of any length. Its arrays are not to be changed. */
public abstract sealed class AbstractType permits Observation, Action {
    private static final int[] NO_INTS = {};
    private static final double[] NO_DOUBLES = {};
    private static final byte[] NO_CHARS = {};
    private static final int HEAD = 16;
    /** Where the sizes of mask and extras are, of 16 bits each. */
    static final int SIZES_BESIDE = 12;

    private final int[] ints;
    private final double[] doubles;
    private final byte[] chars;

    AbstractType(int[] ints, double[] doubles, byte[] chars) {
        this.ints = ints == null ? NO_INTS : ints;
        this.doubles = doubles == null ? NO_DOUBLES : doubles;
        this.chars = chars == null ? NO_CHARS : chars;
    }

    /** Takes the three runs that the rest of {@code body} begins with; their sizes have been checked. */
    AbstractType(ByteBuffer body) {
        ints = new int[body.getInt()];
        doubles = new double[body.getInt()];
        chars = new byte[body.getInt()];
        body.getInt();
        body.asDoubleBuffer().get(doubles);
        body.position(body.position() + 8 * doubles.length);
        body.asIntBuffer().get(ints);
        body.position(body.position() + 4 * ints.length);
        body.get(chars);
    }

    /**
     * Returns the 32-bit integers.
     *
     * @return the ints
     */
    public int[] ints() {
        return ints;
    }

    /**
     * Returns the floating point numbers.
     *
     * @return the doubles
     */
    public double[] doubles() {
        return doubles;
    }

    /**
     * Returns the bytes.
     *
     * @return the chars
     */
    public byte[] chars() {
        return chars;
    }

    @Override
    public boolean equals(Object other) {
        return other != null
                && other.getClass() == getClass()
                && Arrays.equals(((AbstractType) other).body(), body());
    }

    @Override
    public int hashCode() {
        return Arrays.hashCode(body());
    }

    @Override
    public String toString() {
        return "%s(ints=%s, doubles=%s, chars=%s)".formatted(
                getClass().getSimpleName(), Arrays.toString(ints), Arrays.toString(doubles), Arrays.toString(chars));
    }

    /** Returns this as it crosses the wire. */
    abstract byte[] body();

    final byte[] body(byte[] mask, byte[] extras) {
        long size = HEAD + 8L * doubles.length + 4L * ints.length + chars.length + mask.length + extras.length;
        ByteBuffer body = ByteBuffer.allocate(Math.toIntExact(size)).order(ByteOrder.LITTLE_ENDIAN);
        body.putInt(ints.length).putInt(doubles.length).putInt(chars.length).putInt(mask.length | extras.length << 16);
        body.asDoubleBuffer().put(doubles);
        body.position(body.position() + 8 * doubles.length);
        body.asIntBuffer().put(ints);
        body.position(body.position() + 4 * ints.length);
        return body.put(chars).put(mask).put(extras).array();
    }

    /** Returns where the abstract type that begins at {@code start} ends. */
    static int endOf(byte[] body, int start, boolean withMask, boolean withExtras) {
        if (body.length - start < HEAD) {
            throw new GlueException.Protocol(
                    "an observation or action has 16 bytes or more, not " + (body.length - start));
        }
        ByteBuffer counts = littleEndian(body).position(start);
        long ints = Integer.toUnsignedLong(counts.getInt());
        long doubles = Integer.toUnsignedLong(counts.getInt());
        long chars = Integer.toUnsignedLong(counts.getInt());
        int beside = counts.getInt();
        if ((beside & 0xffff) != 0 && !withMask) {
            throw new GlueException.Protocol("an action has a mask");
        }
        if (beside >>> 16 != 0 && !withExtras) {
            throw new GlueException.Protocol("an agent was sent extras, which are not for it");
        }
        long size = HEAD + 8 * doubles + 4 * ints + chars + (beside & 0xffff) + (beside >>> 16);
        if (size > body.length - start) {
            throw new GlueException.Protocol("an observation or action has %d bytes, and by its counts %d"
                    .formatted(body.length - start, size));
        }
        return start + (int) size;
    }

    static ByteBuffer littleEndian(byte[] body) {
        return ByteBuffer.wrap(body).order(ByteOrder.LITTLE_ENDIAN);
    }
}
