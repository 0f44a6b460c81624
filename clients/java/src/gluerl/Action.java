package gluerl;

import java.nio.ByteBuffer;

/** An action: what an agent does. */
public final class Action extends AbstractType {
    private static final byte[] NOTHING = {};

    /**
     * Makes an action of ints alone.
     *
     * @param ints the ints; not copied
     */
    public Action(int... ints) {
        super(ints, null, null);
    }

    /**
     * Makes an action of all three runs, of which any may be null for empty.
     *
     * @param ints the ints; not copied
     * @param doubles the doubles; not copied
     * @param chars the chars; not copied
     */
    public Action(int[] ints, double[] doubles, byte[] chars) {
        super(ints, doubles, chars);
    }

    Action(ByteBuffer body) {
        super(body);
    }

    @Override
    byte[] body() {
        return body(NOTHING, NOTHING);
    }
}
