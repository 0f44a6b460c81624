package gluerl;

/** What learns. One that is {@link Seedable} or {@link Saveable} as well offers these capabilities. */
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

    /** Lets go of what {@link #init} took; another may follow. */
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
