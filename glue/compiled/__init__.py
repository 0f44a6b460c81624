"""What the simulator and the agents share: compilation by numba, records in memory, Java's generator."""
