"""Trajectories: the episodes of a task, step by step, in a compact file.

    with TrajectoryWriter("corridor.traj") as recording:
        recording.run(Run("corridor", {"length": 21}, task_spec))
        recording.start(observation)
        recording.step(action, reward, observation, terminal)   # a terminal step ends the episode
        ...
    for episode in TrajectoryReader("corridor.traj"):
        print(episode.ending, episode.episode_return)

An actions-only recording has no observations, as a deterministic environment reproduces them: `ActionWriter`
writes it, and `Episode.start` and the observations of its steps are None.

The file is gzip, and unpacks to records: one letter, then its fields, all little-endian.
docs/trajectories.md describes every byte. The packed stream is flushed at the end of every episode, so that
a writer that is killed leaves all complete episodes behind.
"""

from glue.trajectory.limits import MAX_BODY, MAX_EPISODE, MAX_STEPS, MAX_TEXT
from glue.trajectory.reader import TrajectoryError, TrajectoryReader
from glue.trajectory.records import MAGIC, ActionSteps, Answer, Block, Ending, Episode, Run, Transition
from glue.trajectory.writer import ActionWriter, TrajectoryWriter

__all__ = [
    "MAGIC",
    "MAX_BODY",
    "MAX_EPISODE",
    "MAX_STEPS",
    "MAX_TEXT",
    "ActionSteps",
    "ActionWriter",
    "Answer",
    "Block",
    "Ending",
    "Episode",
    "Run",
    "TrajectoryError",
    "TrajectoryReader",
    "TrajectoryWriter",
    "Transition",
]
