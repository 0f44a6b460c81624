package gluerl;

/** An agent or environment that can be saved between episodes: the capability {@code save}. */
public interface Saveable {
    /**
     * Saves.
     *
     * @return everything that later episodes depend on
     */
    byte[] save();

    /**
     * Goes on from what {@link #save} returned; comes after an init.
     *
     * @param data these bytes; check them, they may come from someone else
     */
    void load(byte[] data);
}
