package gluerl;

/** An agent that is told how much time it has, where the environment does not wait for it: the capability {@code pace}. */
public interface Paced {
    /**
     * Takes what is known of the time, before a {@link Agent#step}.
     *
     * @param deadline the seconds until the environment's next step
     * @param latency the seconds that the last answer took
     */
    void pace(double deadline, double latency);
}
