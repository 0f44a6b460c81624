import gluerl.Action;
import gluerl.Agent;
import gluerl.Glue;
import gluerl.Observation;
import gluerl.Options;
import gluerl.Seedable;
import java.util.ArrayList;
import java.util.List;
import java.util.regex.Matcher;
import java.util.regex.Pattern;
import java.util.stream.IntStream;

/**
 * Acts at random within the bounds of the task spec: Infinite Mario, or any task with ints as actions. Where the
 * environment says which actions are legal, it chooses among them.
 *
 * <p>glue-experiment --env mario --episodes 10, and beside it: java -cp build/glue-rl.jar examples/RandomAgent.java
 */
final class RandomAgent implements Agent, Seedable {
    /** Numerical Recipes' linear congruential generator: 32 bits of state, of which the upper 16 are drawn. */
    private static final class Generator {
        private int state;

        /** Of the seed, the lower 32 bits count. */
        Generator(long seed) {
            state = (int) seed;
        }

        /** Returns a number from 0 to n - 1. */
        int draw(int n) {
            state = state * 1664525 + 1013904223;
            return (state >>> 16) % n;
        }
    }

    private record Bounds(int low, int high) {}

    private static final Pattern ACTIONS = Pattern.compile("\\bACTIONS\\s+INTS((?:\\s*\\([^)]*\\))*+)");
    private static final Pattern RANGE = Pattern.compile("\\(\\s*(?:(\\d+)\\s+)?(-?\\d+)\\s+(-?\\d+)\\s*\\)");

    private Generator generator = new Generator(0);
    private List<Bounds> bounds = List.of();

    @Override
    public void seed(long seed) {
        generator = new Generator(seed);
    }

    @Override
    public void init(String taskSpec) {
        bounds = boundsOf(taskSpec);
    }

    @Override
    public Action start(Observation observation) {
        return act(observation);
    }

    @Override
    public Action step(double reward, Observation observation) {
        return act(observation);
    }

    private Action act(Observation observation) {
        int[] ints = new int[bounds.size()];
        int first = 0; // the number of an int's minimum among the values of all ints
        for (int i = 0; i < ints.length; i++) {
            Bounds each = bounds.get(i);
            int start = first - each.low;
            int[] legal = IntStream.rangeClosed(each.low, each.high)
                    .filter(value -> observation.legal(start + value))
                    .toArray();
            if (legal.length == 0) {
                throw new IllegalStateException("int %d of the action has no legal value".formatted(i));
            }
            ints[i] = legal[generator.draw(legal.length)];
            first += each.high - each.low + 1;
        }
        return new Action(ints);
    }

    /** Returns the bounds of each int of an action: "ACTIONS INTS (-1 1) (2 0 1)" are three. */
    private static List<Bounds> boundsOf(String taskSpec) {
        List<Bounds> bounds = new ArrayList<>();
        Matcher actions = ACTIONS.matcher(taskSpec);
        Matcher range = RANGE.matcher(actions.find() ? actions.group(1) : "");
        while (range.find()) {
            int count = range.group(1) == null ? 1 : Integer.parseInt(range.group(1));
            for (int i = 0; i < count; i++) {
                bounds.add(new Bounds(Integer.parseInt(range.group(2)), Integer.parseInt(range.group(3))));
            }
        }
        return bounds;
    }

    public static void main(String[] args) {
        System.out.println(Glue.serve(new RandomAgent(), Options.named("random")));
    }
}
