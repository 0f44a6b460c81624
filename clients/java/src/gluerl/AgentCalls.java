package gluerl;

import java.util.Map;

/** The calls to an agent. */
final class AgentCalls implements Calls {
    private final Agent agent;

    AgentCalls(Agent agent) {
        this.agent = agent;
    }

    @Override
    public Result call(Message message) {
        switch (message.kind()) {
            case AGENT_INIT:
                agent.init(message.text());
                return Result.NOTHING;
            case AGENT_START:
                return new Result(agent.start(new Observation(message.reader())).body());
            case AGENT_STEP:
                if (message.scalars().length > 1 && agent instanceof Paced paced) {
                    paced.pace(message.real(1), message.real(2));
                }
                return new Result(agent.step(message.real(0), new Observation(message.reader())).body());
            case AGENT_END:
                agent.end(message.real(0));
                return Result.NOTHING;
            case AGENT_CLEANUP:
                agent.cleanup();
                return Result.NOTHING;
            case AGENT_MESSAGE:
                return new Result(Message.utf8(agent.message(message.text())));
            case AGENT_SEED, AGENT_SAVE, AGENT_LOAD:
                return Calls.common(agent, message);
            case AGENT_METRICS:
                return agent instanceof Measured measured ? new Result(packed(measured.metrics()).body()) : null;
            default:
                return null;
        }
    }

    private static Observation packed(Map<String, Double> metrics) {
        double[] values = metrics.values().stream().mapToDouble(Double::doubleValue).toArray();
        return new Observation(new int[0], values, Message.utf8(String.join("\n", metrics.keySet())));
    }
}
