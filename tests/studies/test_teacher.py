"""The teacher of the imitating network: its prices distinguish death from survival."""

from __future__ import annotations

import numpy as np

from env_server.mario import InfiniteMario
from env_server.mario.level_sets import LEVEL_SETS
from env_server.mario.many.games import SAME_STEP, Games
from env_server.mario.many.views import VIEWS
from studies.teacher import DEATH, Teacher

GAMES = 12


def test_whoever_follows_the_teacher_does_not_die_and_mostly_wins() -> None:
    task, levels = InfiniteMario().parameters, LEVEL_SETS["train-200"]
    games = Games([levels.level(task, i) for i in range(GAMES)], VIEWS["tiles"], SAME_STEP)
    for i in range(GAMES):
        games.seed(i, i)
    games.reset()
    teacher = Teacher(games)
    left = np.arange(GAMES)
    won = deadly = 0
    for _ in range(300):
        deadly += int((teacher.prices(left) == DEATH).sum())
        actions = np.zeros(GAMES, np.int64)
        actions[left] = teacher.plans[left, 0]
        teacher.follow(actions)
        games.step(actions[:, None], np.array([12]))
        over = games.lanes["terminated"][left] == 1
        goals = games.lanes["final_info"][left[over], 1]
        assert goals.all(), "a death"
        won += len(goals)
        left = left[~over]
    assert won >= GAMES - 2
    assert deadly > 0
