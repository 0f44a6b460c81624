"""Object extraction and every relation, on drawn screens."""

from __future__ import annotations

import pytest

from agents.mario import objects
from agents.mario.observation import COIN, FIREBALL, GOOMBA, MUSHROOM, OUTSIDE, PLANT, RED_KOOPA, SOLID, tile
from glue.types import Observation
from tests.agents.screens import Watcher, draw, watched

GROUND = "7" * 21


def test_rows_are_counted_from_the_bottom_and_columns_from_the_level() -> None:
    screen = watched(draw(" M  $", GROUND, camera=40)).screen
    assert (screen.column, screen.row) == (41, 1)
    assert tile(screen, 44, 1) == COIN
    assert tile(screen, 44, 0) == SOLID
    assert (
        tile(screen, 39, 0) == tile(screen, 61, 0) == tile(screen, 44, 16) == tile(screen, 44, -1) == OUTSIDE
    )


def test_the_tile_that_mario_hides_reads_as_blank() -> None:
    assert tile(watched(draw(" M", GROUND)).screen, 1, 1) == ord(" ")


# Monsters


def monsters(things: list[objects.Object]) -> list[objects.Object]:
    return [thing for thing in things if thing.kind == objects.A_MONSTER]


def test_a_monsters_distance_is_that_of_rounded_positions() -> None:
    """From 2.4 to 5.6 the distance is 3.2 tiles, or 6 half tiles; between the rounded positions it is 7."""
    goomba = (GOOMBA, 5.6, 1.0, 0.0, 0.0)
    (seen,) = monsters(Watcher()(draw(" M", GROUND, at=(2.4, 1.0), monsters=[goomba])))
    assert (seen.dx, seen.dy) == (11 - 4, 0)
    (seen,) = monsters(Watcher(grid=1)(draw(" M", GROUND, at=(2.4, 1.0), monsters=[goomba])))
    assert (seen.dx, seen.dy) == (5 - 2, 0)


def test_positions_are_rounded_towards_zero() -> None:
    (seen,) = monsters(Watcher()(draw("M", at=(0.25, 0.25), monsters=[(GOOMBA, -0.4, -0.4, 0.0, 0.0)])))
    assert (seen.dx, seen.dy) == (0, 0)


@pytest.mark.parametrize(
    ("threats", "left", "right", "below", "above"),
    [(objects.THREATS_2010, -3.0, 3.5, -6.0, 4.5), (objects.THREATS_2012, -4.0, 5.5, -2.0, 4.5)],
)
def test_a_monster_is_a_threat_within_a_window(
    threats: tuple[int, int, int, int], left: float, right: float, below: float, above: float
) -> None:
    def is_threat(dx: float, dy: float) -> bool:
        screen = draw(at=(8.0, 8.0), monsters=[(GOOMBA, 8.0 + dx, 8.0 + dy, 0.0, 0.0)])
        (seen,) = monsters(Watcher(threats=threats)(screen))
        return bool(seen.related)

    at_the_edge = [(left, 0.0), (right, 0.0), (0.0, below), (0.0, above)]
    beyond = [(left - 0.5, 0.0), (right + 0.5, 0.0), (0.0, below - 0.5), (0.0, above + 0.5)]
    assert [is_threat(*place) for place in (*at_the_edge, *beyond)] == [True] * 4 + [False] * 4


def test_items_are_monsters_and_fireballs_are_no_threat() -> None:
    mushroom, fireball = monsters(
        Watcher()(
            draw(at=(8.0, 8.0), monsters=[(MUSHROOM, 9.0, 8.0, 0.0, 0.0), (FIREBALL, 9.0, 8.0, 1.0, 0.0)])
        )
    )
    assert (mushroom.type, bool(mushroom.related)) == (MUSHROOM, True)
    assert (fireball.type, bool(fireball.related)) == (FIREBALL, False)


PIPE = ("  M ||", "    ||", GROUND)


@pytest.mark.parametrize(("x", "y", "related"), [(5.0, 1.9, False), (5.0, 2.0, True), (4.0, 1.9, True)])
def test_a_plant_below_the_rim_of_its_pipe_is_no_threat(x: float, y: float, related: bool) -> None:
    (seen,) = monsters(Watcher()(draw(*PIPE, monsters=[(PLANT, x, y, 0.0, 0.0)])))
    assert bool(seen.related) is related


def test_only_a_plant_hides_in_a_pipe() -> None:
    (seen,) = monsters(Watcher()(draw(*PIPE, monsters=[(RED_KOOPA, 5.0, 1.5, 0.0, 0.0)])))
    assert seen.related


@pytest.mark.parametrize(
    ("dx", "speed_x", "speed_y", "motion"),
    [
        (2.0, 0.0, -0.0, objects.STATIONARY),
        (2.0, 0.0, 0.5, objects.VERTICAL),
        (2.0, -0.5, 0.0, objects.TOWARDS),
        (-2.0, 0.5, 1.0, objects.TOWARDS),
        (2.0, 0.5, 0.0, objects.AWAY),
        (-2.0, -0.5, 0.0, objects.AWAY),
        (0.0, 0.5, 0.0, objects.NO_MOTION),
    ],
)
def test_motion_relative_to_mario(dx: float, speed_x: float, speed_y: float, motion: int) -> None:
    screen = draw(at=(8.0, 8.0), monsters=[(GOOMBA, 8.0 + dx, 8.0, speed_x, speed_y)])
    (seen,) = monsters(Watcher()(screen))
    assert seen.motion == motion


def test_absolute_motion_tells_the_nine_pairs_of_signs_apart() -> None:
    seen: set[int] = set()
    for speed_x in (-0.5, 0.0, 0.5):
        for speed_y in (-0.5, -0.0, 0.5):
            screen = draw(at=(8.0, 8.0), monsters=[(GOOMBA, 9.0, 8.0, speed_x, speed_y)])
            seen.update(thing.motion for thing in monsters(Watcher(absolute_motion=True)(screen)))
    assert len(seen) == 9


def test_a_monster_stays_the_same_until_the_types_before_it_change() -> None:
    def goombas_and_koopas(*kinds: int) -> Observation:
        return draw(at=(8.0, 8.0), monsters=[(kind, 9.0 + i, 8.0, 0.0, 0.0) for i, kind in enumerate(kinds)])

    watcher = Watcher()

    def ids(*kinds: int) -> list[int]:
        return [thing.id for thing in monsters(watcher(goombas_and_koopas(*kinds)))]

    goomba, koopa = ids(GOOMBA, RED_KOOPA)
    assert ids(GOOMBA, RED_KOOPA) == [goomba, koopa]
    assert ids(GOOMBA) == [goomba]
    same, new = ids(GOOMBA, RED_KOOPA)
    assert same == goomba
    assert new not in (goomba, koopa)
    other, also_other = ids(MUSHROOM, RED_KOOPA)
    assert len({goomba, koopa, new, other, also_other}) == 5


# Coins and questions


def tiles_of(things: list[objects.Object], kind: int) -> list[tuple[int, int]]:
    """Return (dx, dy) of every object of a kind, all of which must be related."""
    found = [thing for thing in things if thing.kind == kind]
    assert all(thing.related for thing in found)
    return sorted((thing.dx, thing.dy) for thing in found)


def everywhere(mark: str) -> list[str]:
    """Return a screen full of one tile, with Mario in column 10 of row 8."""
    full = mark * 21
    return [full] * 7 + [mark * 10 + "M" + mark * 10] + [full] * 8


@pytest.mark.parametrize(
    ("mark", "kind", "columns"), [("$", objects.A_COIN, 1), ("?", objects.A_QUESTION, 2)]
)
def test_a_tile_is_reachable_some_columns_and_three_rows_away_and_never_below(
    mark: str, kind: int, columns: int
) -> None:
    seen = tiles_of(Watcher()(draw(*everywhere(mark))), kind)
    reached = [(dx, dy) for dx in range(-columns, columns + 1) for dy in range(4)]
    assert seen == sorted(place for place in reached if place != (0, 0))


def test_a_coin_is_known_by_its_tile() -> None:
    watcher = Watcher()
    (first,) = watcher(draw(" M$", GROUND, camera=3))
    (again,) = watcher(draw("  $M", GROUND, camera=3))
    (scrolled,) = watcher(draw("M$", GROUND, camera=4))
    (other,) = watcher(draw(" M$", GROUND, camera=4))
    assert first.id == again.id == scrolled.id != other.id
    assert (first.dx, again.dx, scrolled.dx) == (1, -1, 1)


def test_an_observation_without_objects_has_none() -> None:
    assert Watcher()(draw(" M", GROUND)) == []


# Platforms


@pytest.mark.parametrize(
    ("rows", "seen"),
    [
        ((" $$$$$   ", "", "  11111   ", "", "   M"), [(0, 4), (1, 4), (2, 4)]),  # strictly between its ends
        (("   $     ", "  11111   ", "   M"), [(0, 2)]),  # in the row above, reachable anyway
        (("   $", "", "", "", "  11111   ", "   M"), []),  # more than three rows above the platform
        (("        $ ", "", "       111 ", "", "    M"), [(4, 4)]),  # starts three columns to the right
        (("         $ ", "", "        111 ", "", "    M"), []),  # four are too far
        (("      $ ", "", "     1111 ", "", "", "    M"), []),  # three rows up are too high
        (("   $ ", "  111", "       ", "    M"), [(-1, 3)]),  # two rows up are not
        (("  $   ", "", " 111 ", "", "     M"), [(-3, 4)]),  # ends two columns to the left
        (("  $   ", "", " 111 ", "", "      M"), []),  # three are too far
        (("   $   ", "", "  1117", "", "    M"), []),  # no blank on its right
        (("   $   ", "", "7 711117 11117 ", "", "    M"), []),  # no blank on either side
        (("$$$", "", "111 ", "", " M"), []),  # its left end may lie outside the view
        (("$".rjust(20), "", "111".rjust(21), "", "M".rjust(18)), []),  # and so may its right end
    ],
)
def test_a_coin_is_reachable_via_a_platform(rows: tuple[str, ...], seen: list[tuple[int, int]]) -> None:
    assert tiles_of(Watcher(via_platforms=True)(draw(*rows)), objects.A_COIN) == seen


def test_platforms_help_only_who_knows_of_them() -> None:
    rows = ("   $ ?   ", "", "", "  11111   ", "", "M")
    far = draw(*rows)
    assert Watcher()(far) == []
    seen = Watcher(via_platforms=True)(far)
    assert tiles_of(seen, objects.A_COIN) == [(3, 5)]
    assert tiles_of(seen, objects.A_QUESTION) == [(5, 5)]


# Pits


def pits(things: list[objects.Object]) -> list[tuple[int, int]]:
    return [(thing.id, thing.dx) for thing in things if thing.kind == objects.A_PIT]


@pytest.mark.parametrize(
    ("mario", "seen"),
    [
        ("  M", []),  # three columns before it
        ("   M", [(5, 2)]),
        ("    M", [(5, 1)]),
        ("     M", [(5, 0)]),
        ("       M", [(5, -2)]),  # over its last column
        ("        M", []),  # beyond
    ],
)
def test_a_pit_is_dangerous_from_two_columns_before_it_to_its_end(
    mario: str, seen: list[tuple[int, int]]
) -> None:
    assert pits(Watcher()(draw(mario, "77777   7777777777777"))) == seen


def test_a_pit_is_known_by_its_first_column() -> None:
    assert pits(Watcher()(draw("    M", "77777   7777777777777", camera=30))) == [(35, 1)]


@pytest.mark.parametrize(
    "rows",
    [
        ("   M", "     777", "77777   77777"),  # something solid above it
        ("   M", "7777", "     77777777"),  # not solid at the bottom on its left
        ("   M", "7777", "7777    "),  # its right end is out of view
        ("   M", "     !", "77777!7777777"),  # the finish line
    ],
)
def test_what_is_not_a_pit(rows: tuple[str, ...]) -> None:
    assert pits(Watcher()(draw(*rows))) == []


# Single tiles


@pytest.mark.parametrize(
    ("rows", "above"),
    [
        ((" ?", "", " M", "", GROUND), "?"),
        ((" b", "", "", " M", GROUND), "b"),
        ((" M", "", GROUND), " "),
        (("?", " M", "", " 7", GROUND), " "),
        ((" M", "", ""), ""),
    ],
)
def test_the_tile_above_is_four_rows_over_the_floor(rows: tuple[str, ...], above: str) -> None:
    assert chr(objects.tile_above(watched(draw(*rows)).screen)) == (above or "\0")


def test_a_mario_far_above_the_screen_is_no_trouble() -> None:
    assert objects.tile_above(watched(draw(GROUND, at=(1.5, 2.0e9))).screen) == ord(" ")
