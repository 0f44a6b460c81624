import gluerl.Experiment;
import gluerl.Glue;
import gluerl.GlueException;
import gluerl.Options;

/**
 * An experiment of a few episodes, for whatever agent and environment are there.
 *
 * <p>With a hub (glue-hub), an agent and an environment: java -cp build/glue-rl.jar examples/FewEpisodes.java 10 1
 */
final class FewEpisodes {
    private static final long MAX_STEPS = 1000;

    public static void main(String[] args) {
        int episodes = args.length > 0 ? Integer.parseInt(args[0]) : 10;
        long seed = args.length > 1 ? Long.parseLong(args[1]) : 1;
        try (Experiment glue = Glue.connect(Options.named("a few episodes"))) {
            glue.init(seed);
            for (int done = 0; done < episodes; ) {
                try {
                    glue.episode(MAX_STEPS);
                    done++;
                    System.out.printf("episode %d: return %s, %d steps%n", done, glue.episodeReturn(), glue.numSteps());
                } catch (GlueException.PeerLost error) {
                    System.err.println("again, because " + error.getMessage());
                }
            }
            glue.cleanup();
        }
    }
}
