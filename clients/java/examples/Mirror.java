import gluerl.AbstractType;
import gluerl.Action;
import gluerl.Agent;
import gluerl.Environment;
import gluerl.Experiment;
import gluerl.Glue;
import gluerl.GlueException;
import gluerl.Measured;
import gluerl.Observation;
import gluerl.Options;
import gluerl.Paced;
import gluerl.Saveable;
import gluerl.Seedable;
import java.io.ByteArrayOutputStream;
import java.nio.charset.StandardCharsets;
import java.util.ArrayList;
import java.util.Arrays;
import java.util.LinkedHashMap;
import java.util.List;
import java.util.Map;
import java.util.TreeMap;
import java.util.stream.Collectors;
import java.util.stream.DoubleStream;
import java.util.stream.IntStream;
import java.util.stream.Stream;

/**
 * The mirror, with which glue-conform judges this library: docs/clients.md says what it does.
 *
 * <p>glue-conform agent -- java -cp build/glue-rl.jar examples/Mirror.java agent
 */
abstract class Mirror implements Seedable, Saveable {
    private static final Options OPTIONS = Options.named("mirror");
    private static final byte[] NO_CHARS = {};

    int count;
    private long seed;

    @Override
    public void seed(long number) {
        seed = number;
    }

    @Override
    public byte[] save() {
        return utf8(count + " " + seed);
    }

    @Override
    public void load(byte[] data) {
        String[] numbers = new String(data, StandardCharsets.UTF_8).split(" ");
        count = Integer.parseInt(numbers[0]);
        seed = Long.parseLong(numbers[1]);
    }

    public String message(String text) {
        if (text.equals("fail")) {
            throw new IllegalStateException("asked to fail");
        }
        return text;
    }

    static boolean isEmpty(AbstractType shown) {
        return shown.ints().length + shown.doubles().length + shown.chars().length == 0;
    }

    static int[] mirrored(int[] ints, int more) {
        return IntStream.rangeClosed(0, ints.length)
                .map(i -> i < ints.length ? ints[ints.length - 1 - i] : more)
                .toArray();
    }

    /** An observation as an action that has what is beside the observation behind its runs. */
    static Action shown(Observation seen) {
        boolean[] mask = seen.mask();
        IntStream legal = IntStream.range(0, mask.length).filter(i -> mask[i]);
        List<Double> doubles = new ArrayList<>();
        ByteArrayOutputStream chars = new ByteArrayOutputStream();
        chars.writeBytes(seen.chars());
        new TreeMap<>(seen.extras()).forEach((name, extra) -> {
            chars.writeBytes(utf8("\n" + name + "="));
            if (extra instanceof Double number) {
                doubles.add(number);
            } else if (extra instanceof double[] numbers) {
                Arrays.stream(numbers).forEach(doubles::add);
            } else if (extra instanceof byte[] bytes) {
                chars.writeBytes(bytes);
            } else if (extra instanceof long[] numbers) {
                chars.writeBytes(utf8(Arrays.stream(numbers).mapToObj(Long::toString).collect(Collectors.joining(" "))));
            } else {
                chars.writeBytes(utf8(extra.toString()));
            }
        });
        return new Action(
                IntStream.concat(Arrays.stream(seen.ints()), legal).toArray(),
                DoubleStream.concat(Arrays.stream(seen.doubles()), doubles.stream().mapToDouble(one -> one)).toArray(),
                chars.toByteArray());
    }

    static double[] mirrored(double[] doubles, double... more) {
        IntStream places = IntStream.range(0, doubles.length);
        DoubleStream reversed = places.mapToDouble(i -> doubles[doubles.length - 1 - i]);
        return DoubleStream.concat(reversed, Arrays.stream(more)).toArray();
    }

    static byte[] mirrored(byte[] chars) {
        byte[] reversed = new byte[chars.length];
        for (int i = 0; i < chars.length; i++) {
            reversed[i] = chars[chars.length - 1 - i];
        }
        return reversed;
    }

    static double sum(int[] ints) {
        return Arrays.stream(ints).asLongStream().sum();
    }

    static byte[] utf8(String text) {
        return text.getBytes(StandardCharsets.UTF_8);
    }

    static final class MirrorAgent extends Mirror implements Agent, Measured, Paced {
        private double[] told = {};

        @Override
        public void pace(double deadline, double latency) {
            told = new double[] {deadline, latency};
        }

        @Override
        public Map<String, Double> metrics() {
            Map<String, Double> metrics = new LinkedHashMap<>();
            metrics.put("count", (double) count);
            metrics.put("half the count", count / 2.0);
            return metrics;
        }

        @Override
        public void init(String taskSpec) {
            count = 0;
        }

        @Override
        public Action start(Observation observation) {
            return step(0, observation);
        }

        @Override
        public Action step(double reward, Observation observation) {
            count++;
            Action shown = shown(observation);
            DoubleStream more = DoubleStream.concat(DoubleStream.of(sum(shown.ints()), reward), Arrays.stream(told));
            told = new double[0];
            return isEmpty(shown) ? shown : new Action(
                    mirrored(shown.ints(), count),
                    mirrored(shown.doubles(), more.toArray()),
                    mirrored(shown.chars()));
        }

        @Override
        public void end(double reward) {
            count++;
        }
    }

    static final class MirrorEnvironment extends Mirror implements Environment {
        @Override
        public String init() {
            count = 0;
            return "a mirror, größer than it is";
        }

        @Override
        public Observation start() {
            return new Observation(++count);
        }

        @Override
        public Step step(Action action) {
            count++;
            byte[] chars = action.chars();
            int last = chars.length > 0 ? chars[chars.length - 1] : 0;
            Observation observation = isEmpty(action) ? new Observation() : new Observation(
                    mirrored(action.ints(), count),
                    mirrored(action.doubles(), sum(action.ints())),
                    mirrored(chars));
            return new Step(
                    action.doubles().length > 0 ? action.doubles()[0] : 0,
                    last == '!',
                    last == '&' ? beside(observation, action) : observation,
                    last == '?');
        }

        private Observation beside(Observation observation, Action action) {
            boolean[] mask = new boolean[action.ints().length];
            for (int i = 0; i < mask.length; i++) {
                mask[i] = action.ints()[i] != 0;
            }
            return observation.withMask(mask).withExtras(Map.of(
                    "count", count,
                    "half", count + 0.5,
                    "text", "größer",
                    "chars", action.chars(),
                    "ints", Arrays.stream(action.ints()).asLongStream().toArray(),
                    "doubles", action.doubles()));
        }
    }

    /** Does what it is told, and shows what came of it. */
    static final class MirrorExperiment {
        private final List<String> notices = new ArrayList<>();
        private final Experiment glue = Glue.connect(
                OPTIONS, (event, role, name) -> notices.add(event + " " + role + " " + name));

        void run() {
            Action shown = new Action(null, null, utf8("ready"));
            while (true) {
                Environment.Step order = glue.envStep(shown);
                byte[] chars = order.observation().chars();
                int space = IntStream.range(0, chars.length).filter(i -> chars[i] == ' ').findFirst().orElse(chars.length);
                String verb = new String(chars, 0, space, StandardCharsets.UTF_8);
                byte[] argument = Arrays.copyOfRange(chars, Math.min(space + 1, chars.length), chars.length);
                if (verb.equals("end")) {
                    glue.close();
                    return;
                }
                try {
                    shown = carryOut(verb, argument, order);
                } catch (GlueException.RequestFailed error) {
                    shown = words("ERROR " + error.code() + " " + error.getMessage());
                }
            }
        }

        private Action carryOut(String verb, byte[] argument, Environment.Step order) {
            String text = new String(argument, StandardCharsets.UTF_8);
            int[] ints = order.observation().ints();
            double[] doubles = order.observation().doubles();
            Observation observation = new Observation(ints, doubles, argument).withMask(order.observation().mask());
            switch (verb) {
                case "RL_INIT":
                    return words(text.isEmpty() ? glue.init() : glue.init(Long.parseLong(text)));
                case "RL_START":
                    Experiment.Start start = glue.start();
                    return both(start.observation(), start.action(), new int[0]);
                case "RL_STEP":
                    Experiment.Step step = glue.step();
                    return both(step.observation(), step.action(), flag(step.terminal(), step.truncated()), step.reward());
                case "RL_EPISODE":
                    return result(flag(glue.episode(Long.parseLong(text)), false), NO_CHARS);
                case "RL_RETURN":
                    return result(new int[0], NO_CHARS, glue.episodeReturn());
                case "RL_NUM_STEPS":
                    return words(Long.toString(glue.numSteps()));
                case "RL_NUM_EPISODES":
                    return words(Long.toString(glue.numEpisodes()));
                case "RL_AGENT_MESSAGE":
                    return words(glue.agentMessage(text));
                case "RL_ENV_MESSAGE":
                    return words(glue.envMessage(text));
                case "RL_CLEANUP":
                    glue.cleanup();
                    break;
                case "RL_ENV_START":
                    return both(glue.envStart(), new Action(), new int[0]);
                case "RL_ENV_STEP":
                    Environment.Step half = glue.envStep(new Action(ints, doubles, argument));
                    return both(half.observation(), new Action(), flag(half.terminal(), half.truncated()), half.reward());
                case "RL_AGENT_START":
                    return both(new Observation(), glue.agentStart(observation), new int[0]);
                case "RL_AGENT_STEP":
                    return both(new Observation(), glue.agentStep(order.reward(), observation), new int[0]);
                case "RL_AGENT_END":
                    glue.agentEnd(order.reward());
                    break;
                case "RL_AGENT_SAVE":
                    return result(new int[0], glue.agentSave());
                case "RL_ENV_SAVE":
                    return result(new int[0], glue.envSave());
                case "RL_AGENT_METRICS":
                    Map<String, Double> metrics = glue.agentMetrics();
                    double[] values = metrics.values().stream().mapToDouble(Double::doubleValue).toArray();
                    return result(new int[0], utf8(String.join("\n", metrics.keySet())), values);
                case "RL_AGENT_LOAD":
                    glue.agentLoad(argument);
                    break;
                case "RL_ENV_LOAD":
                    glue.envLoad(argument);
                    break;
                case "notices":
                    String lines = String.join("\n", notices);
                    notices.clear();
                    return words(lines);
                default:
                    throw new IllegalStateException("the mirror was ordered to do " + verb + ", which it does not know");
            }
            return words("");
        }

        private static int[] flag(boolean terminal, boolean truncated) {
            return new int[] {truncated ? 2 : terminal ? 1 : 0};
        }

        private static Action words(String text) {
            return result(new int[0], utf8(text));
        }

        private static Action result(int[] ints, byte[] chars, double... doubles) {
            return new Action(ints, DoubleStream.concat(Arrays.stream(doubles), DoubleStream.of(sum(ints))).toArray(), chars);
        }

        private static Action both(Observation observation, Action action, int[] ints, double... doubles) {
            Action seen = shown(observation);
            byte[] chars = Arrays.copyOf(seen.chars(), seen.chars().length + action.chars().length);
            System.arraycopy(action.chars(), 0, chars, seen.chars().length, action.chars().length);
            return result(
                    Stream.of(seen.ints(), action.ints(), ints).flatMapToInt(Arrays::stream).toArray(),
                    chars,
                    Stream.of(seen.doubles(), action.doubles(), doubles).flatMapToDouble(Arrays::stream).toArray());
        }
    }

    public static void main(String[] args) {
        try {
            switch (args[0]) {
                case "agent" -> System.out.println(Glue.serve(new MirrorAgent(), OPTIONS));
                case "environment" -> System.out.println(Glue.serve(new MirrorEnvironment(), OPTIONS));
                default -> new MirrorExperiment().run();
            }
        } catch (GlueException.HubClosed goodbye) {
            System.out.println(goodbye.getMessage());
        } catch (GlueException error) {
            System.out.println(error.getMessage());
            System.exit(1);
        }
    }
}
