"""docs/model/Glue.tla quotes docs/protocol-reference.md, keeps its promises, and each mutant breaks one.

TLC checks the model where TLA2TOOLS names its jar, as in .ci/run.
"""

from __future__ import annotations

import os
import re
import subprocess
import tomllib
from pathlib import Path
from typing import Any, Final

import pytest

from tests.house.imports import ROOT
from tests.proof import size

FOLDER: Final = ROOT / "docs/model"
MODEL: Final = (FOLDER / "Glue.tla").read_text(encoding="utf-8")
INVARIANTS: Final = (FOLDER / "Glue.cfg").read_text(encoding="utf-8")
MUTANTS: Final = tomllib.loads(Path(__file__).with_name("mutants.toml").read_text("utf-8"))["mutant"]
LIVENESS: Final = (FOLDER / "Liveness.cfg").read_text(encoding="utf-8")

LEFT_OUT: Final = {
    "write headers and bodies as this page says, within the limits, and never more than one body",
    "ignore HEARTBEAT, NOTICE and ERRORs that it has no use for",
}
"""Rules of a peer about bodies and about messages that the model leaves out."""

with_tlc = pytest.mark.skipif(
    "TLA2TOOLS" not in os.environ,
    reason="TLA2TOOLS names no tla2tools.jar; docs/verification.md says how to install it",
)


def flat(text: str) -> str:
    return re.sub(r"\s+", " ", text).replace("**", "")


def quotations() -> list[str]:
    return re.findall(r"^\\\* (?:MUST|MUST NOT|SHOULD): (.+)$", MODEL, re.MULTILINE)


def rules() -> list[str]:
    """Return the rules under "A peer MUST" of docs/protocol-reference.md."""
    page = (ROOT / "docs/protocol-reference.md").read_text(encoding="utf-8")
    found = re.search(r"^A peer MUST\n\n(.*?)\n\n", page, re.MULTILINE | re.DOTALL)
    assert found is not None
    return [flat(rule).rstrip(";.") for rule in found[1].removeprefix("- ").split("\n- ")]


def test_the_model_quotes_the_protocol() -> None:
    page = flat((ROOT / "docs/protocol-reference.md").read_text(encoding="utf-8"))

    assert len(quotations()) > 8
    assert [text for text in quotations() if flat(text) not in page] == []


def test_every_rule_of_a_peer_is_an_action_or_left_out() -> None:
    assert set(rules()) - set(quotations()) == LEFT_OUT


def tlc(folder: Path, workers: int, config: Path, model: str) -> str:
    """Return the output of TLC for a model in a folder."""
    java = ["java", "-XX:+UseSerialGC", "-Xmx4g", "-cp", os.environ["TLA2TOOLS"], "tlc2.TLC", "-deadlock"]
    options = ["-workers", str(workers), "-metadir", str(folder), "-config", str(config), model]
    return subprocess.run(java + options, cwd=folder, capture_output=True, text=True, timeout=1200).stdout


def check(folder: Path, model: str, config: str) -> str:
    """Return the output of TLC for a model and its configuration."""
    (folder / "Glue.tla").write_text(model, encoding="utf-8")
    (folder / "Glue.cfg").write_text(config, encoding="utf-8")
    return tlc(folder, 2, folder / "Glue.cfg", "Glue.tla")


@with_tlc
@pytest.mark.proof
@pytest.mark.timeout(1200)
@pytest.mark.parametrize(
    "config",
    [INVARIANTS.replace("Faults = 3", size("Faults = 2", "Faults = 3")), LIVENESS],
    ids=["invariants", "liveness"],
)
def test_the_model_keeps_its_promises(config: str, tmp_path: Path) -> None:
    output = check(tmp_path, MODEL, config)

    assert "No error has been found." in output, output[-5000:]


@with_tlc
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant["mistake"].replace(" ", "-"))
def test_a_mistake_breaks_a_promise(mutant: dict[str, Any], tmp_path: Path) -> None:
    assert MODEL.count(mutant["before"]) == 1
    liveness = mutant["breaks"] == "RequestsEnd"
    # Only this invariant: if several are broken, TLC names the first that one of its threads finds.
    config = (
        LIVENESS if liveness else INVARIANTS.partition("INVARIANTS")[0] + f"INVARIANT {mutant['breaks']}\n"
    )

    output = check(tmp_path, MODEL.replace(mutant["before"], mutant["after"]), config)

    refuted = "Temporal properties were violated" if liveness else f"Invariant {mutant['breaks']} is violated"
    assert refuted in output, output[-5000:]
    print(f"{mutant['mistake']}: {output.count(chr(10) + 'State ')} states")
