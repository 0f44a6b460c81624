package gluerl;

import java.nio.ByteBuffer;
import java.nio.ByteOrder;
import java.util.Map;

/** An observation: what an environment shows of its state, and what is beside it. */
public final class Observation extends AbstractType {
    static final int MAX_BESIDE = 65535; // bytes of a mask, and of extras

    private static final byte[] NO_MASK = {};

    private final byte[] mask;
    private final int maskValues; // as many as were given, or as the bytes of a mask that was received have bits
    private final Map<String, Object> extras;

    /**
     * Makes an observation of ints alone.
     *
     * @param ints the ints; not copied
     */
    public Observation(int... ints) {
        this(ints, null, null);
    }

    /**
     * Makes an observation of all three runs, of which any may be null for empty.
     *
     * @param ints the ints; not copied
     * @param doubles the doubles; not copied
     * @param chars the chars; not copied
     */
    public Observation(int[] ints, double[] doubles, byte[] chars) {
        super(ints, doubles, chars);
        mask = NO_MASK;
        maskValues = 0;
        extras = Map.of();
    }

    private Observation(Observation runs, byte[] mask, int maskValues, Map<String, Object> extras) {
        super(runs.ints(), runs.doubles(), runs.chars());
        this.mask = mask;
        this.maskValues = maskValues;
        this.extras = extras;
    }

    /** Takes the observation that the rest of {@code body} begins with; its size has been checked. */
    Observation(ByteBuffer body) {
        this(body, body.getInt(body.position() + SIZES_BESIDE));
    }

    private Observation(ByteBuffer body, int sizes) {
        super(body);
        mask = new byte[sizes & 0xffff];
        maskValues = 8 * mask.length;
        byte[] packed = new byte[sizes >>> 16];
        body.get(mask).get(packed);
        extras = packed.length == 0 ? Map.of() : Extras.unpack(packed);
    }

    /**
     * Returns whether a value of the next action is legal: all are, unless there is a mask. The values of its ints are
     * numbered from 0, one int after another, each from its minimum: after an int from 0 to 2, 3 is the minimum of the
     * next.
     *
     * @param value the number of the value
     * @return whether it is legal
     */
    public boolean legal(int value) {
        return mask.length == 0
                || (value >= 0 && value / 8 < mask.length && (mask[value / 8] >> value % 8 & 1) != 0);
    }

    /**
     * Returns the mask: what {@link #legal} says of each value, and false up to a multiple of 8.
     *
     * @return the mask, empty if there is none
     */
    public boolean[] mask() {
        boolean[] all = new boolean[8 * mask.length];
        for (int i = 0; i < all.length; i++) {
            all[i] = legal(i);
        }
        return all;
    }

    /** Returns the number of values of the mask, 0 without one. */
    int maskValues() {
        return maskValues;
    }

    /**
     * Returns the named values for everyone but the agent: each a Long, a Double, a String, a byte[], a long[] or a
     * double[].
     *
     * @return the extras, which cannot be changed; an agent's observation has none
     */
    public Map<String, Object> extras() {
        return extras;
    }

    /**
     * Returns this observation with a mask. An environment with masks has the word {@code masks} in its task spec's
     * EXTRA.
     *
     * @param legal which values of the next action are legal, numbered as {@link #legal} does; empty if all are
     * @return an observation that shares the arrays of this one
     */
    public Observation withMask(boolean... legal) {
        byte[] packed = new byte[(legal.length + 7) / 8];
        if (packed.length > MAX_BESIDE) {
            throw new IllegalArgumentException("a mask has at most 524280 values, not " + legal.length);
        }
        for (int i = 0; i < legal.length; i++) {
            packed[i / 8] |= (byte) (legal[i] ? 1 << i % 8 : 0);
        }
        return new Observation(this, packed, legal.length, extras);
    }

    /**
     * Returns this observation with named values for everyone but the agent: at most 64, with names of 1 to 64
     * printable characters, and 65,535 bytes in all.
     *
     * @param values each an Integer or Long, a Float or Double, a String, a byte[], a long[] or a double[]
     * @return an observation that shares the arrays of this one
     */
    public Observation withExtras(Map<String, ?> values) {
        return new Observation(this, mask, maskValues, values.isEmpty() ? Map.of() : Extras.unpack(Extras.pack(values)));
    }

    @Override
    byte[] body() {
        return body(mask, Extras.pack(extras));
    }

    /** Cuts off what is beside the observation of {@code body} and not wanted. */
    static byte[] cut(byte[] body, boolean withMask, boolean withExtras) {
        int sizes = littleEndian(body).getInt(SIZES_BESIDE);
        int mask = sizes & 0xffff;
        int extras = sizes >>> 16;
        if ((mask == 0 || withMask) && (extras == 0 || withExtras)) {
            return body;
        }
        int keptMask = withMask ? mask : 0;
        int keptExtras = withExtras ? extras : 0;
        int end = body.length - mask - extras;
        ByteBuffer kept = ByteBuffer.allocate(end + keptMask + keptExtras).order(ByteOrder.LITTLE_ENDIAN);
        kept.put(body, 0, end).put(body, end, keptMask).put(body, end + mask, keptExtras);
        return kept.putInt(SIZES_BESIDE, keptMask | keptExtras << 16).array();
    }
}
