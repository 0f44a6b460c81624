package gluerl;

/** The way in: serve an agent or an environment, or connect an experiment. */
public final class Glue {
    private Glue() {}

    /**
     * Lets an agent take part in a session until the hub says goodbye. A hub that is not there yet is waited for; a
     * connection that breaks is made again, and the episode goes on.
     *
     * @param agent the agent
     * @param options where
     * @return the reason of the hub's goodbye
     * @throws GlueException.Config if an option is wrong
     * @throws GlueException.Refused if the hub does not let it in
     * @throws GlueException.PlayerThrew if the agent threw an exception
     * @throws GlueException.Protocol if what is at the address broke the protocol
     */
    public static String serve(Agent agent, Options options) {
        return new Player("agent", new AgentCalls(agent), agent, options).serve();
    }

    /**
     * Lets an environment take part in a session, as {@link #serve(Agent, Options)} does an agent.
     *
     * @param environment the environment
     * @param options where
     * @return the reason of the hub's goodbye
     */
    public static String serve(Environment environment, Options options) {
        return new Player("environment", new EnvironmentCalls(environment), environment, options).serve();
    }

    /**
     * Joins a session as its experiment, once a hub is there.
     *
     * @param options where
     * @return the experiment
     * @throws GlueException.Config if an option is wrong
     * @throws GlueException.Refused if the hub does not let it in
     */
    public static Experiment connect(Options options) {
        return connect(options, (event, role, name) -> {});
    }

    /**
     * Joins a session as its experiment, once a hub is there.
     *
     * @param options where
     * @param notices is called when players come and go
     * @return the experiment
     */
    public static Experiment connect(Options options, Experiment.Notices notices) {
        return new Experiment(options, notices);
    }
}
