"""Time, network, chance and threads: the only modules that ask the system for them.

Everything else in the package looks the functions up here when it calls them, so that a simulation which
replaces them runs all of it on a virtual clock and a network of its own (tests/simulation).
"""
