import gluerl.Action;
import gluerl.Environment;
import gluerl.Glue;
import gluerl.Observation;
import gluerl.Options;

/**
 * RL-Glue's skeleton environment, a walk along 21 states, from the middle to either end.
 *
 * <p>glue-experiment --agent random --episodes 10, and beside it: java -cp build/glue-rl.jar examples/Skeleton.java
 */
final class Skeleton implements Environment {
    private static final int FIRST = 10;
    private static final int LAST = 20;

    private int state = FIRST;

    @Override
    public String init() {
        return "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1.0 "
                + "OBSERVATIONS INTS (0 20) ACTIONS INTS (0 1) REWARDS (-1.0 1.0) EXTRA skeleton";
    }

    @Override
    public Observation start() {
        state = FIRST;
        return new Observation(state);
    }

    /** Action 0 goes down, 1 goes up; state 0 ends with the reward -1, state 20 with +1. */
    @Override
    public Step step(Action action) {
        state += action.ints()[0] == 1 ? 1 : -1;
        double reward = state == LAST ? 1 : state == 0 ? -1 : 0;
        return new Step(reward, reward != 0, new Observation(state));
    }

    @Override
    public String message(String text) {
        return "I don't know how to respond to your message";
    }

    public static void main(String[] args) {
        System.out.println(Glue.serve(new Skeleton(), Options.named("skeleton")));
    }
}
