package gluerl;

/** An agent or environment whose random choices can be repeated: the capability {@code seed}. */
public interface Seedable {
    /**
     * From now on, draws all random choices from this number; comes before an init.
     *
     * @param seed 0 to 2^63 - 1
     */
    void seed(long seed);
}
