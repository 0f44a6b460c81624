"""Time, network, chance and threads, as the system has them, and modules built on these four directly.

All other modules of the package look their functions up here at each call, so that a simulation that replaces
them runs the whole package on a virtual clock and network (tests/simulation).
"""
