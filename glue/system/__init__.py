"""Time, network, chance and threads: the only modules that ask the system for them.

All other modules of the package look the functions up here at each call, so that a simulation that replaces
them runs the whole package on a virtual clock and network (tests/simulation).
"""
