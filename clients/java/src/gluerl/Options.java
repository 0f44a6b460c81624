package gluerl;

import java.util.function.Consumer;

/**
 * The hub and the session that a program joins, and its name.
 *
 * @param hub the hub's address, such as {@code tcp://127.0.0.1:4097} or {@code ipc:///tmp/hub}
 * @param session the session's name: 1 to 255 printable characters
 * @param name what people see
 * @param log receives lines for people
 */
public record Options(String hub, String session, String name, Consumer<String> log) {
    /**
     * Returns the defaults: hub and session of the environment variables {@code GLUE_HUB} and {@code GLUE_SESSION}, else
     * {@code tcp://127.0.0.1:4097} and {@code default}; lines for people go to standard error.
     *
     * @param name what people see
     * @return the options
     */
    public static Options named(String name) {
        return new Options(
                System.getenv().getOrDefault("GLUE_HUB", "tcp://127.0.0.1:4097"),
                System.getenv().getOrDefault("GLUE_SESSION", "default"),
                name,
                System.err::println);
    }

    /**
     * Returns these options with another hub.
     *
     * @param address the hub's address
     * @return the options
     */
    public Options withHub(String address) {
        return new Options(address, session, name, log);
    }

    /**
     * Returns these options with another session.
     *
     * @param other the session's name
     * @return the options
     */
    public Options withSession(String other) {
        return new Options(hub, other, name, log);
    }

    /**
     * Returns these options with another place for lines for people.
     *
     * @param taker takes them
     * @return the options
     */
    public Options withLog(Consumer<String> taker) {
        return new Options(hub, session, name, taker);
    }
}
