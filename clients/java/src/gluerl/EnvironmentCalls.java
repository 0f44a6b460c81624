package gluerl;

/** The calls to an environment. */
final class EnvironmentCalls implements Calls {
    private final Environment environment;
    private Masks masks = new Masks("");

    EnvironmentCalls(Environment environment) {
        this.environment = environment;
    }

    @Override
    public Result call(Message message) {
        switch (message.kind()) {
            case ENV_INIT:
                String taskSpec = environment.init();
                masks = new Masks(taskSpec);
                return new Result(Message.utf8(taskSpec));
            case ENV_START:
                return new Result(masks.checked("start", environment.start()).body());
            case ENV_STEP:
                Environment.Step step = environment.step(new Action(message.reader()));
                Object end = step.truncated() ? (Object) Message.CUT_OFF : (Object) step.terminal();
                return new Result(masks.checked("step", step.observation()).body(), step.reward(), end);
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
