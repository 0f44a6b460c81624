package gluerl;

import java.nio.ByteBuffer;

/** An observation: what an environment shows of its state. */
public final class Observation extends AbstractType {
    /**
     * Makes an observation of ints alone.
     *
     * @param ints the ints; not copied
     */
    public Observation(int... ints) {
        super(ints, null, null);
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
    }

    Observation(ByteBuffer body) {
        super(body);
    }
}
