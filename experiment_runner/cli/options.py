"""Parts of the command lines that several commands share; those of every package are in `glue.cli.shared`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final, TypeVar
from urllib.parse import urlsplit

import click

from experiment_runner.plan.limits import Backend
from glue.cli.shared import DIRECTORY, prepare
from glue.errors import ConfigError, ExperimentError

if TYPE_CHECKING:
    from experiment_runner.analysis.settings import Setting
    from experiment_runner.view.server import Place

_Command = TypeVar("_Command", bound=Callable[..., Any])

_WHERE = {
    Backend.LOCAL: "on this machine",
    Backend.RAY: "on a Ray cluster",
    Backend.SLURM: "as a job array of SLURM",
}

RUN: Final = click.argument("directory", metavar="RUN", type=DIRECTORY)
RUNS: Final = click.argument("directories", metavar="RUN...", nargs=-1, required=True, type=DIRECTORY)
"""Decorators of a command that takes one run, or several."""

json_option: Final = click.option("--json", "as_json", is_flag=True, help="Print JSON.")

over_option: Final = click.option(
    "--over",
    type=click.Choice(["episodes", "steps"]),
    default="episodes",
    show_default=True,
    help="Count in episodes, or in steps: each step has the return of the episode under way.",
)
"""Decorator of a command that counts in episodes or in steps."""

select_option: Final = click.option(
    "--select",
    multiple=True,
    metavar="TEXT",
    help="Only settings with TEXT in their names, which glue-results show prints; repeat it for several.",
)
"""Decorator of a command that shows settings; see `selected`."""


def selected(settings: Sequence[Setting], texts: Sequence[str]) -> list[Setting]:
    """Return the settings with one of some texts in their names; all, if there is no text.

    Raises:
        ConfigError: no setting has it.
    """
    found = [setting for setting in settings if not texts or any(text in setting.label for text in texts)]
    if not found and settings:
        raise ConfigError(f"no setting has {' or '.join(texts)} in its name: there is {settings[0].label}")
    return found


def backend_options(*backends: Backend) -> Callable[[_Command], _Command]:
    """Return a decorator that adds the options `--workers`, `--engine` and `--address` to a command.

    Args:
        backends: the values of `--engine`.
    """
    engine = click.option(
        "--engine",
        type=click.Choice([backend.value for backend in backends]),
        default=Backend.LOCAL.value,
        show_default=True,
        help=f"Where trials run: {', '.join(_WHERE[backend] for backend in backends)}.",
    )
    workers = click.option(
        "--workers", type=click.IntRange(1), metavar="N", help="Trials at a time, each in its own process."
    )
    address = click.option(
        "--address",
        metavar="HOST:PORT",
        help="Ray cluster. [default: the one that Ray finds, or else one on this machine]",
    )
    return lambda command: workers(engine(address(command)))


def check_address(backend: Backend, address: str | None) -> None:
    """Check the address of a cluster.

    Raises:
        ConfigError: it is malformed, or trials do not run on a cluster.
    """
    from experiment_runner.executors.workers import parse_address

    if address is not None:
        if backend is not Backend.RAY:
            raise ConfigError("--address is the address of a Ray cluster: add --engine ray")
        parse_address(address)


@contextmanager
def naming_out(otherwise: str = "") -> Iterator[None]:
    """Name the option --out in the message of a `DirectoryTaken`.

    Args:
        otherwise: another remedy, appended to the message.
    """
    from experiment_runner.store.layout import DirectoryTaken

    try:
        yield
    except DirectoryTaken as error:
        raise ExperimentError(f"{error}: choose another directory with --out{otherwise}") from None


class LazyGroup(click.Group):
    """A group whose subcommands are imported when they are used, so that `--help` answers at once.

    Args:
        modules: the first sentence of each subcommand's help, by its module in this folder and its name.
    """

    def __init__(self, *arguments: Any, modules: Mapping[str, Mapping[str, str]], **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        self._places = {name: module for module, summaries in modules.items() for name in summaries}
        for summaries in modules.values():
            for name, summary in summaries.items():
                self.add_command(click.Command(name, help=summary))

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        name, command, rest = super().resolve_command(ctx, args)
        if command is not None and name in self._places:
            found = vars(import_module(f"{__package__}.{self._places[name]}")).values()
            command = next(each for each in found if isinstance(each, click.Command) and each.name == name)
            prepare(command)
        return name, command, rest


def place_of(host: str, port: int | None, proxy: str, insecure: bool) -> Place:
    """Return the place of a page that asks for tokens, which cross a network only encrypted.

    Args:
        host, port, proxy: see `Place`.
        insecure: whether other machines may reach it without a proxy.

    Raises:
        ConfigError: they could, or the proxy is no address.
    """
    from experiment_runner.view.server import Place, is_loopback

    if not insecure and not is_loopback(host):
        raise ConfigError(
            f"{host} can be reached by other machines, and the page is not encrypted: put a proxy in front "
            "of it (docs/view.md), or add --insecure"
        )
    if proxy and (urlsplit(proxy).scheme not in ("http", "https") or not urlsplit(proxy).netloc):
        raise ConfigError(f"--proxy is an address such as https://lab.example/runs, not {proxy}")
    return Place(host, port, proxy)
