"""RL-Glue's rules without I/O: the engine, the calls on a player, and all three roles in one process."""
