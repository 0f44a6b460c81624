package gluerl;

/** An environment: the task. If it is also {@link Seedable} or {@link Saveable}, it offers these capabilities. */
public interface Environment {
    /**
     * The outcome of an action.
     *
     * @param reward the reward
     * @param terminal whether the episode is over
     * @param observation the observation after the action
     * @param truncated whether it is over only because it was cut off, in a state that is not terminal: the agent is shown
     *     the observation, and no end
     */
    record Step(double reward, boolean terminal, Observation observation, boolean truncated) {
        /**
         * Makes a step of an episode that is not cut off.
         *
         * @param reward the reward
         * @param terminal whether the episode is over
         * @param observation the observation after the action
         */
        public Step(double reward, boolean terminal, Observation observation) {
            this(reward, terminal, observation, false);
        }
    }

    /**
     * Prepares.
     *
     * @return the task spec: a text that describes observations, actions and rewards
     */
    String init();

    /**
     * Begins an episode.
     *
     * @return its first observation
     */
    Observation start();

    /**
     * Executes an action.
     *
     * @param action the action
     * @return what came of it
     */
    Step step(Action action);

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
