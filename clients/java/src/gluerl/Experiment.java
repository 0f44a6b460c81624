package gluerl;

import java.nio.charset.StandardCharsets;
import java.util.LinkedHashMap;
import java.util.Map;

/**
 * RL-Glue's verbs over a hub. Each waits for the players, and throws {@link GlueException.PeerLost},
 * {@link GlueException.PeerFailed}, {@link GlueException.Unsupported} or {@link GlueException.HubClosed}. One thread at a
 * time may use it.
 */
public final class Experiment implements AutoCloseable {
    /**
     * What RL_start returns.
     *
     * @param observation the first observation
     * @param action the first action
     */
    public record Start(Observation observation, Action action) {}

    /**
     * What RL_step returns.
     *
     * @param reward the reward
     * @param terminal whether the episode is over
     * @param observation the observation after the step
     * @param action the next action; after a terminal step the one that was executed
     * @param truncated whether the environment cut the episode off, in a state that is not terminal
     */
    public record Step(
            double reward, boolean terminal, Observation observation, Action action, boolean truncated) {}

    /** Is told when players come and go. */
    @FunctionalInterface
    public interface Notices {
        /**
         * A player {@code joined}, was {@code lost}, has {@code returned} or is {@code slow}.
         *
         * @param event which of these
         * @param role the role of the player
         * @param name its name, for people
         */
        void notice(String event, String role, String name);
    }

    private final Link link;
    private final Notices notices;
    private long seq;
    private boolean answered; // whether the hub has answered since it last said that it did not know us
    private boolean closed;

    Experiment(Options options, Notices notices) {
        this.notices = notices;
        link = new Link("experiment", options, "mask", "extras");
        try {
            while (!link.isWelcomed()) {
                receive();
            }
        } catch (RuntimeException error) {
            close(error.getMessage());
            throw error;
        }
    }

    /**
     * RL_init without a seed.
     *
     * @return the task spec
     */
    public String init() {
        return ask(Kind.RL_INIT, null, (Object) null).text();
    }

    /**
     * RL_init with a seed, from which both players are seeded.
     *
     * @param seed 0 to 2^63 - 1
     * @return the task spec
     */
    public String init(long seed) {
        return ask(Kind.RL_INIT, null, seed).text();
    }

    /**
     * RL_start.
     *
     * @return the first observation and action
     */
    public Start start() {
        var body = ask(Kind.RL_START, null).reader();
        return new Start(new Observation(body), new Action(body));
    }

    /**
     * RL_step.
     *
     * @return what came of it
     */
    public Step step() {
        Message reply = ask(Kind.RL_STEP, null);
        var body = reply.reader();
        return new Step(
                reply.real(0), reply.truth(1), new Observation(body), new Action(body), reply.isCutOff(1));
    }

    /**
     * RL_episode.
     *
     * @param maxSteps the largest number of steps; 0 for any
     * @return whether the episode reached its end, and was not cut off
     */
    public boolean episode(long maxSteps) {
        Message reply = ask(Kind.RL_EPISODE, null, maxSteps);
        return reply.truth(0) && !reply.isCutOff(0);
    }

    /**
     * RL_return.
     *
     * @return the sum of the episode's rewards
     */
    public double episodeReturn() {
        return ask(Kind.RL_RETURN, null).real(0);
    }

    /**
     * RL_num_steps.
     *
     * @return the number of the episode's steps
     */
    public long numSteps() {
        return ask(Kind.RL_NUM_STEPS, null).integer(0);
    }

    /**
     * RL_num_episodes.
     *
     * @return the number of episodes that reached their end since the init
     */
    public long numEpisodes() {
        return ask(Kind.RL_NUM_EPISODES, null).integer(0);
    }

    /**
     * RL_agent_message.
     *
     * @param text a text for the agent
     * @return its answer
     */
    public String agentMessage(String text) {
        return ask(Kind.RL_AGENT_MESSAGE, Message.utf8(text)).text();
    }

    /**
     * RL_env_message.
     *
     * @param text a text for the environment
     * @return its answer
     */
    public String envMessage(String text) {
        return ask(Kind.RL_ENV_MESSAGE, Message.utf8(text)).text();
    }

    /** RL_cleanup. */
    public void cleanup() {
        ask(Kind.RL_CLEANUP, null);
    }

    /**
     * RL_env_start, for an experiment that stands between the players.
     *
     * @return the first observation
     */
    public Observation envStart() {
        return new Observation(ask(Kind.RL_ENV_START, null).reader());
    }

    /**
     * RL_env_step.
     *
     * @param action the action to execute
     * @return what came of it
     */
    public Environment.Step envStep(Action action) {
        Message reply = ask(Kind.RL_ENV_STEP, action.body());
        return new Environment.Step(
                reply.real(0), reply.truth(1), new Observation(reply.reader()), reply.isCutOff(1));
    }

    /**
     * RL_agent_start.
     *
     * @param observation the first observation
     * @return the first action
     */
    public Action agentStart(Observation observation) {
        return new Action(ask(Kind.RL_AGENT_START, observation.body()).reader());
    }

    /**
     * RL_agent_step.
     *
     * @param reward the reward of the last action
     * @param observation the observation after it
     * @return the next action
     */
    public Action agentStep(double reward, Observation observation) {
        return new Action(ask(Kind.RL_AGENT_STEP, observation.body(), reward).reader());
    }

    /**
     * RL_agent_end.
     *
     * @param reward the last reward
     */
    public void agentEnd(double reward) {
        ask(Kind.RL_AGENT_END, null, reward);
    }

    /**
     * Saves the agent.
     *
     * @return what it made of itself
     */
    public byte[] agentSave() {
        return ask(Kind.RL_AGENT_SAVE, null).body();
    }

    /**
     * Loads the agent.
     *
     * @param data what {@link #agentSave} returned
     */
    public void agentLoad(byte[] data) {
        ask(Kind.RL_AGENT_LOAD, data);
    }

    /**
     * Saves the environment.
     *
     * @return what it made of itself
     */
    public byte[] envSave() {
        return ask(Kind.RL_ENV_SAVE, null).body();
    }

    /**
     * Loads the environment.
     *
     * @param data what {@link #envSave} returned
     */
    public void envLoad(byte[] data) {
        ask(Kind.RL_ENV_LOAD, data);
    }

    /**
     * RL_agent_metrics.
     *
     * @return the agent's own numbers by name, in its order
     */
    public Map<String, Double> agentMetrics() {
        Observation metrics = new Observation(ask(Kind.RL_AGENT_METRICS, null).reader());
        String names = new String(metrics.chars(), StandardCharsets.UTF_8);
        Map<String, Double> found = new LinkedHashMap<>();
        double[] values = metrics.doubles();
        String[] all = names.split("\n", -1);
        for (int i = 0; i < Math.min(values.length, all.length); i++) {
            found.put(all[i], values[i]);
        }
        return found;
    }

    /** Says goodbye to the hub, and leaves. */
    @Override
    public void close() {
        close("the experiment is over");
    }

    /**
     * Says goodbye to the hub with a reason, and leaves.
     *
     * @param reason for people
     */
    public void close(String reason) {
        if (!closed) {
            closed = true;
            link.close(reason);
        }
    }

    /** Returns the reply to a request, however often the network fails. */
    private Message ask(Kind kind, byte[] body, Object... scalars) {
        byte[][] request = link.encode(kind, seq + 1, body, scalars);
        seq += 1;
        if (link.isWelcomed()) {
            link.send(request);
        }
        while (true) {
            Message message = receive();
            if (message == null) {
                continue;
            }
            if (message.kind() == Kind.WELCOME) {
                link.send(request);
            } else if (message.seq() == seq && message.kind() == Kind.ERROR) {
                answered = true;
                throw GlueException.RequestFailed.of(message.text(0), message.text(1));
            } else if (message.seq() == seq && message.kind() == kind) {
                answered = true;
                return message;
            } else if (message.kind() == Kind.ERROR) {
                link.log("the hub says: " + message.text(1));
            }
        }
    }

    /** Returns the next message, having acted on it if it is a WELCOME or a NOTICE. */
    private Message receive() {
        if (closed) {
            throw new GlueException.HubClosed("this experiment was closed");
        }
        Message message = link.receive();
        if (message == null) {
            return null;
        }
        if (message.kind() == Kind.NOTICE) {
            notices.notice(message.text(0), message.text(1), message.text(2));
            return null;
        }
        if (message.kind() == Kind.WELCOME && !message.truth(1) && answered) {
            answered = false;
            throw new GlueException.HubClosed(
                    "the hub knows nothing of this experiment: it was restarted, or had given it up");
        }
        return message;
    }
}
