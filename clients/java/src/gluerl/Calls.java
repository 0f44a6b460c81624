package gluerl;

/** What the hub may ask of a player. */
interface Calls {
    /** The result of a call: the scalars of the answer, and its body or null. */
    record Result(byte[] body, Object... scalars) {
        static final Result NOTHING = new Result(null);
    }

    /** Carries a call out, or returns null if it is not one of this player's. */
    Result call(Message message);

    /** Carries out what agents and environments have in common. */
    static Result common(Object player, Message message) {
        switch (message.kind()) {
            case AGENT_SEED, ENV_SEED:
                if (player instanceof Seedable seedable) {
                    seedable.seed(message.integer(0));
                    return Result.NOTHING;
                }
                return null;
            case AGENT_SAVE, ENV_SAVE:
                return player instanceof Saveable saveable ? new Result(saveable.save()) : null;
            case AGENT_LOAD, ENV_LOAD:
                if (player instanceof Saveable saveable) {
                    saveable.load(message.body());
                    return Result.NOTHING;
                }
                return null;
            default:
                return null;
        }
    }
}
