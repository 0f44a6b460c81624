"""RL-Glue's rules without I/O: the engine, the calls on a player, sessions, and all of it in one process."""
