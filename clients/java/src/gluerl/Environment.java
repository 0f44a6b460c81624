package gluerl;

/** The task. One that is {@link Seedable} or {@link Saveable} as well offers these capabilities. */
public interface Environment {
    /**
     * What came of an action.
     *
     * @param reward the reward
     * @param terminal whether the episode is over
     * @param observation the observation after the action
     */
    record Step(double reward, boolean terminal, Observation observation) {}

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
