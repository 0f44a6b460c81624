package gluerl;

/** An agent: it learns. If it is also {@link Seedable} or {@link Saveable}, it offers these capabilities. */
public interface Agent {
    /**
     * Prepares for a task; what was learned before is forgotten.
     *
     * @param taskSpec the environment's description of observations, actions and rewards
     */
    void init(String taskSpec);

    /**
     * Begins an episode.
     *
     * @param observation the first observation
     * @return the first action
     */
    Action start(Observation observation);

    /**
     * Takes a step.
     *
     * @param reward the reward of the last action
     * @param observation the observation after it
     * @return the next action
     */
    Action step(double reward, Observation observation);

    /**
     * Ends an episode that has reached its end.
     *
     * @param reward the reward of the last action
     */
    default void end(double reward) {}

    /** Releases what {@link #init} acquired; another init may follow. */
    default void cleanup() {}

    /**
     * Answers a text with a text; may come at any time.
     *
     * @param text the text
     * @return the answer, here an empty one
     */
    default String message(String text) {
        return "";
    }
}
