"""What simulator and agents share of compiled code: numba, records of memory, Java's generator."""
