package gluerl;

/** The errors of this library; a message names the cause and the remedy. */
public sealed class GlueException extends RuntimeException {
    private static final long serialVersionUID = 1;

    GlueException(String message) {
        super(message);
    }

    GlueException(String message, Throwable cause) {
        super(message, cause);
    }

    /** An address, a session's name or the environment is wrong. */
    public static final class Config extends GlueException {
        private static final long serialVersionUID = 1;

        Config(String message) {
            super(message);
        }
    }

    /** The program at the other end broke the protocol. */
    public static final class Protocol extends GlueException {
        private static final long serialVersionUID = 1;

        Protocol(String message) {
            super(message);
        }
    }

    /** The hub refuses this program. */
    public static final class Refused extends GlueException {
        private static final long serialVersionUID = 1;

        Refused(String message) {
            super(message);
        }
    }

    /** The hub ended the session, or knows nothing of this experiment any more. */
    public static final class HubClosed extends GlueException {
        private static final long serialVersionUID = 1;

        HubClosed(String message) {
            super(message);
        }
    }

    /** The agent or environment that is served threw an exception, which is the cause; the hub is informed. */
    public static final class PlayerThrew extends GlueException {
        private static final long serialVersionUID = 1;

        PlayerThrew(String message, Throwable cause) {
            super(message, cause);
        }
    }

    /** A request of the experiment failed. */
    public static sealed class RequestFailed extends GlueException {
        private static final long serialVersionUID = 1;
        /** The code of the hub. */
        private final String code;

        RequestFailed(String code, String message) {
            super(message);
            this.code = code;
        }

        /**
         * Returns the hub's code for the error, such as {@code peer-lost}.
         *
         * @return the code
         */
        public String code() {
            return code;
        }

        static RequestFailed of(String code, String message) {
            return switch (code) {
                case "peer-lost" -> new PeerLost(message);
                case "peer-failed" -> new PeerFailed(message);
                case "unsupported" -> new Unsupported(message);
                default -> new RequestFailed(code, message);
            };
        }
    }

    /** A player was lost, and the episode is void: start another. The hub waits for the player, or for another. */
    public static final class PeerLost extends RequestFailed {
        private static final long serialVersionUID = 1;

        PeerLost(String message) {
            super("peer-lost", message);
        }
    }

    /** A player failed in a call, or broke the protocol. */
    public static final class PeerFailed extends RequestFailed {
        private static final long serialVersionUID = 1;

        PeerFailed(String message) {
            super("peer-failed", message);
        }
    }

    /** The player lacks the capability for this request. */
    public static final class Unsupported extends RequestFailed {
        private static final long serialVersionUID = 1;

        Unsupported(String message) {
            super("unsupported", message);
        }
    }
}
