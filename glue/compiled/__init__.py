"""Tools shared by the simulator and the agents: compilation by numba, records in memory, Java's generator."""
