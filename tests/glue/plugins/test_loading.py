"""Agents and environments by name: installed, in a module, in a file; and the errors of each."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from env_server.toys import MinesEnvironment
from experiment_runner.plan.plan import RoleSpec
from experiment_runner.plan.user_files import user_files
from glue.errors import ConfigError
from glue.plugins import loading
from glue.plugins.loading import find, names
from glue.wire.messages import Role


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working directory; modules imported from it are forgotten afterwards."""
    monkeypatch.chdir(tmp_path)
    searched = loading._searched  # by tests of other modules, in this process
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path not in searched])
    monkeypatch.setattr(sys, "modules", sys.modules.copy())
    monkeypatch.setattr(loading, "_aside", {})
    monkeypatch.setattr(loading, "_searched", [])
    return tmp_path


def write(folder: Path, name: str, text: str) -> None:
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(text, encoding="utf-8")


def test_installed_class_is_found_by_its_name_and_by_its_module() -> None:
    assert find(Role.ENVIRONMENT, "mines") is MinesEnvironment
    assert find(Role.ENVIRONMENT, "env_server.toys:MinesEnvironment") is MinesEnvironment
    assert "mines" in names(Role.ENVIRONMENT)


@pytest.mark.parametrize("name", ["mine:Mine", "mine.py:Mine", "./mine.py:Mine"])
def test_class_is_found_in_the_working_directory(folder: Path, name: str) -> None:
    write(folder, "mine.py", "class Mine: pass")
    assert find(Role.AGENT, name).__name__ == "Mine"


def test_file_may_import_what_is_beside_it(folder: Path) -> None:
    write(folder, "elsewhere/beside_mine.py", "class Mine: pass")
    write(folder, "elsewhere/mine.py", "from beside_mine import Mine")
    assert find(Role.AGENT, "elsewhere/mine.py:Mine").__name__ == "Mine"


def test_files_of_two_folders_have_their_own_modules_of_one_name_and_all_are_recorded(folder: Path) -> None:
    for who in ("alice", "bob"):
        write(folder, f"{who}/policy.py", f"NAME = {who!r}")
        write(folder, f"{who}/parts/part.py", f"NAME = {who!r}")
        write(
            folder,
            f"{who}/agent.py",
            "import policy\nfrom parts import part\nclass Mine: uses = policy, part",
        )
    names = [f"{who}/agent.py:Mine" for who in ("alice", "bob", "alice")]
    found: list[Any] = [find(Role.AGENT, name) for name in names]
    alice, bob, again = (one.uses for one in found)
    assert [module.NAME for module in (*alice, *bob)] == ["alice", "alice", "bob", "bob"]
    assert again == alice, "with what they have stored"
    recorded = user_files([RoleSpec(name) for name in names])
    assert recorded.keys() >= {str(path) for path in folder.rglob("*.py")}


@pytest.mark.parametrize("name", ["mine.py:Mine", "mine:Mine"])
def test_what_is_installed_is_not_shadowed_by_what_is_beside_a_file(folder: Path, name: str) -> None:
    write(folder, "colorsys.py", "raise AssertionError(__file__)")
    write(folder, "mine.py", "import colorsys\nfrom colorsys import hls_to_rgb\nclass Mine: pass")
    assert find(Role.AGENT, name).__name__ == "Mine"


def test_summaries_are_docstrings_read_without_an_import() -> None:
    program = (
        "import sys; from glue.plugins.loading import summaries; from glue.wire.messages import Role\n"
        "print(summaries(Role.AGENT)['sarsa']); print('agents' in sys.modules, 'numpy' in sys.modules)"
    )
    shown = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert "SARSA" in shown.stdout
    assert shown.stdout.splitlines()[-1] == "False False"


@pytest.mark.parametrize(
    ("name", "error"),
    [
        ("minez", "no environment is called 'minez'; did you mean mines?"),
        ("", "no environment is called ''"),
        (":Mine", "no environment is called ':Mine'"),
        ("mine:", "no environment is called 'mine:'"),
        ("mine.py", "did you mean mine.py:Mine? (your own is named module:Class or path/to/file.py:Class)"),
        ("mine", "no environment is called 'mine'; did you mean mine.py:Mine?"),
        ("nowhere.py", "no environment is called 'nowhere.py'; choose from"),
        ("nowhere.py:Mine", "there is no file nowhere.py"),
        ("nowhere:Mine", "there is no module 'nowhere' here"),
        ("mine:Mime", "mine has no class 'Mime'; did you mean Mine?"),
        ("mine.py:Mime", "mine.py has no class 'Mime'; did you mean Mine?"),
        ("mine.py:number", "mine.py has no class 'number'"),
        *((name, "gymnasium:NAME") for name in ("gymnasium", "gymnasium:")),
    ],
)
def test_name_of_nothing_is_an_error_that_says_so(folder: Path, name: str, error: str) -> None:
    write(folder, "mine.py", "number = 3\nclass Mine: pass")
    with pytest.raises(ConfigError) as raised:
        find(Role.ENVIRONMENT, name)
    assert error in str(raised.value)


@pytest.mark.parametrize("name", ["broken:Mine", "broken.py:Mine"])
@pytest.mark.parametrize(
    ("text", "error"),
    [
        (
            "\nimport nowhere",
            "cannot be imported: ModuleNotFoundError: No module named 'nowhere' ({file}, line 2)",
        ),
        ("\n\n1 / 0", "cannot be imported: ZeroDivisionError: division by zero ({file}, line 3)"),
        ("import sys\nsys.exit(3)", "cannot be imported: SystemExit: 3 ({file}, line 2)"),
    ],
)
def test_file_that_cannot_be_imported_is_an_error_that_says_where(
    folder: Path, name: str, text: str, error: str
) -> None:
    write(folder, "broken.py", text)
    with pytest.raises(ConfigError) as raised:
        find(Role.AGENT, name)
    expected = error.format(file=folder / "broken.py")
    assert str(raised.value) == f"{name.partition(':')[0]} {expected}"


def test_syntax_error_is_shown_with_its_line_and_a_caret(folder: Path) -> None:
    write(folder, "broken.py", "\nclass Mine(:")
    with pytest.raises(ConfigError) as raised:
        find(Role.AGENT, "broken.py:Mine")
    shown = str(raised.value)
    assert "broken.py" in shown
    assert "line 2\n    class Mine(:\n               ^\nSyntaxError" in shown


def test_module_that_says_what_it_needs_is_quoted_alone(folder: Path) -> None:
    write(folder, "needy.py", "from glue.errors import ConfigError\nraise ConfigError('install the extra')")
    with pytest.raises(ConfigError) as raised:
        find(Role.AGENT, "needy:Mine")
    assert str(raised.value) == "install the extra"


def test_players_that_need_more_say_so_before_they_look_for_a_hub(tmp_path: Path) -> None:
    """This holds even in a plain install."""
    program = """
import sys
missing = "nothing"
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == missing:
            raise ModuleNotFoundError(name, name=name)
sys.meta_path.insert(0, Missing())
from glue_rl.commands import agent
for missing, name in (
    ("gymnasium", "sb3"), ("stable_baselines3", "sb3"), ("soar_sml", "soar-mines"), ("nothing", "soar")
):
    sys.argv[1:] = [name, "--hub", "ipc:///nowhere/hub"]
    try:
        agent()
    except SystemExit as end:
        assert end.code == 2
"""
    shown = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, timeout=60
    )
    assert shown.returncode == 0, shown.stderr
    remedies = ("glue-rl[sb3]", "glue-rl[sb3]", "glue-rl[soar]", "--productions")
    for line, remedy in zip(shown.stderr.splitlines(), remedies, strict=True):
        assert remedy in line
