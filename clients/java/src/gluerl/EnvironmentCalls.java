package gluerl;

/** The calls to an environment. */
final class EnvironmentCalls implements Calls {
    private final Environment environment;

    EnvironmentCalls(Environment environment) {
        this.environment = environment;
    }

    @Override
    public Result call(Message message) {
        switch (message.kind()) {
            case ENV_INIT:
                return new Result(Message.utf8(environment.init()));
            case ENV_START:
                return new Result(environment.start().body());
            case ENV_STEP:
                Environment.Step step = environment.step(new Action(message.reader()));
                Object end = step.truncated() ? (Object) Message.CUT_OFF : (Object) step.terminal();
                return new Result(step.observation().body(), step.reward(), end);
            case ENV_CLEANUP:
                environment.cleanup();
                return Result.NOTHING;
            case ENV_MESSAGE:
                return new Result(Message.utf8(environment.message(message.text())));
            case ENV_SEED, ENV_SAVE, ENV_LOAD:
                return Calls.common(environment, message);
            default:
                return null;
        }
    }
}
