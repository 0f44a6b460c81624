package gluerl;

import static gluerl.Kind.Body.ACTION;
import static gluerl.Kind.Body.BOTH;
import static gluerl.Kind.Body.BYTES;
import static gluerl.Kind.Body.NONE;
import static gluerl.Kind.Body.OBSERVATION;
import static gluerl.Kind.Body.SEEN;
import static gluerl.Kind.Body.TEXT;

import java.util.HashMap;
import java.util.Map;

/**
 * Every kind of message, and what it carries to the hub and from it: docs/protocol-reference.md, "Every kind of message".
 *
 * <p>Scalars are written as one letter each: {@code i} int, {@code f} float, {@code b} bool, {@code e} the end of an
 * episode, which is a bool or {@link Message#CUT_OFF}, {@code t} text, {@code n} int or nil, {@code x} binary, {@code I}
 * array of int, {@code T} array of text, {@code F} float; T and F may be missing in what is received. A null says that the
 * kind does not go that way.
 */
enum Kind {
    AGENT_INIT(4, "", NONE, "", TEXT),
    AGENT_START(5, "", ACTION, "", SEEN),
    AGENT_STEP(6, "", ACTION, "fFF", SEEN),
    AGENT_END(7, "", NONE, "f", NONE),
    AGENT_CLEANUP(8, "", NONE, "", NONE),
    AGENT_MESSAGE(10, "", TEXT, "", TEXT),
    AGENT_SEED(80, "", NONE, "i", NONE),
    AGENT_SAVE(81, "", BYTES, "", NONE),
    AGENT_LOAD(82, "", NONE, "", BYTES),
    AGENT_METRICS(86, "", ACTION, "", NONE),

    ENV_INIT(11, "", TEXT, "", NONE),
    ENV_START(12, "", OBSERVATION, "", NONE),
    ENV_STEP(13, "fe", OBSERVATION, "", ACTION),
    ENV_CLEANUP(14, "", NONE, "", NONE),
    ENV_MESSAGE(19, "", TEXT, "", TEXT),
    ENV_SEED(83, "", NONE, "i", NONE),
    ENV_SAVE(84, "", BYTES, "", NONE),
    ENV_LOAD(85, "", NONE, "", BYTES),

    RL_INIT(20, "n", NONE, "", TEXT),
    RL_START(21, "", NONE, "", BOTH),
    RL_STEP(22, "", NONE, "fe", BOTH),
    RL_CLEANUP(23, "", NONE, "", NONE),
    RL_RETURN(24, "", NONE, "f", NONE),
    RL_NUM_STEPS(25, "", NONE, "i", NONE),
    RL_NUM_EPISODES(26, "", NONE, "i", NONE),
    RL_EPISODE(27, "i", NONE, "e", NONE),
    RL_AGENT_MESSAGE(33, "", TEXT, "", TEXT),
    RL_ENV_MESSAGE(34, "", TEXT, "", TEXT),
    RL_ENV_START(36, "", NONE, "", OBSERVATION),
    RL_ENV_STEP(37, "", ACTION, "fe", OBSERVATION),
    RL_AGENT_START(38, "", SEEN, "", ACTION),
    RL_AGENT_STEP(39, "f", SEEN, "", ACTION),
    RL_AGENT_END(40, "f", NONE, "", NONE),
    RL_AGENT_SAVE(90, "", NONE, "", BYTES),
    RL_AGENT_LOAD(91, "", BYTES, "", NONE),
    RL_ENV_SAVE(92, "", NONE, "", BYTES),
    RL_ENV_LOAD(93, "", BYTES, "", NONE),
    RL_AGENT_METRICS(94, "", NONE, "", ACTION),

    HELLO(64, "ItxttT", NONE, null, NONE),
    WELCOME(65, null, NONE, "ibffiT", NONE),
    REFUSE(66, null, NONE, "tt", NONE),
    HEARTBEAT(67, "", NONE, "", NONE),
    GOODBYE(68, "t", NONE, "t", NONE),
    ERROR(69, "tt", NONE, "tt", NONE),
    NOTICE(70, null, NONE, "ttt", NONE);

    /** What a body is; an agent is shown an observation without extras. */
    enum Body {
        NONE,
        TEXT,
        BYTES,
        ACTION,
        SEEN,
        OBSERVATION,
        BOTH
    }

    private static final Map<Long, Kind> BY_CODE = new HashMap<>();

    static {
        for (Kind kind : values()) {
            BY_CODE.put((long) kind.code, kind);
        }
    }

    final int code;
    final String toHub;
    final Body bodyToHub;
    final String fromHub;
    final int neededFromHub;
    final Body bodyFromHub;

    Kind(int code, String toHub, Body bodyToHub, String fromHub, Body bodyFromHub) {
        this.code = code;
        this.toHub = toHub;
        this.bodyToHub = bodyToHub;
        this.fromHub = fromHub;
        this.neededFromHub = fromHub == null ? 0 : fromHub.replaceAll("[TF]", "").length();
        this.bodyFromHub = bodyFromHub;
    }

    /** Returns the kind that the hub sends with this code, or null. */
    static Kind fromHub(long code) {
        Kind kind = BY_CODE.get(code);
        return kind == null || kind.fromHub == null ? null : kind;
    }
}
