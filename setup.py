"""How distributions are built: our packages in a folder of their own, the same bytes from the same files.

Installers mix the files of distributions that have a package of the same name, and there are others called
glue, agents and experiment_runner. In a wheel ours lie in `glue_rl/packages`, which `glue_rl.pth` puts at the
end of the module path; see `glue_rl`. An editable install uses the folders of the checkout.
"""

from __future__ import annotations

import gzip
import os
import re
import shutil
import tarfile
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py
from setuptools.command.sdist import sdist

REPOSITORY = "https://github.com/glue-rl/glue-rl"
PACKAGES = ("glue", "env_server", "agents", "experiment_runner")
# The time of every file, in seconds since 1970, unless a builder sets another.
DATE = int(os.environ.setdefault("SOURCE_DATE_EPOCH", "1577836800"))


class Packages(build_py):
    def run(self) -> None:
        if self.editable_mode:
            super().run()
            return
        library = Path(self.build_lib)
        shutil.rmtree(library, ignore_errors=True)  # files that have since been deleted
        super().run()
        home = library / "glue_rl" / "packages"
        home.mkdir()
        for package in PACKAGES:
            (library / package).rename(home / package)
        (library / "glue_rl.pth").write_text("glue_rl/packages\n", encoding="utf-8")
        for path in library.rglob("*"):
            path.chmod(0o755 if path.is_dir() else 0o644)


class Source(sdist):
    def make_archive(self, base_name: str, *_: object, base_dir: str, **__: object) -> str:  # type: ignore[override]
        name = f"{base_name}.tar.gz"
        with (
            open(name, "wb") as raw,
            gzip.GzipFile("", "wb", mtime=DATE, fileobj=raw) as packed,
            tarfile.open(fileobj=packed, mode="w", format=tarfile.PAX_FORMAT) as archive,
        ):
            for path in sorted(Path(base_dir).rglob("*")):
                archive.add(path, recursive=False, filter=_plain)
        return name


def _plain(entry: tarfile.TarInfo) -> tarfile.TarInfo:
    entry.mtime, entry.uid, entry.gid, entry.uname, entry.gname = DATE, 0, 0, "", ""
    entry.mode = 0o755 if entry.isdir() else 0o644
    return entry


def _readme() -> str:
    """Return README.md with links that also work where it stands alone, as on PyPI."""
    text = Path("README.md").read_text(encoding="utf-8")
    text = re.sub(r"(!\[[^]]*\]\()(?!\w+:)", rf"\1{REPOSITORY}/raw/main/", text)
    return re.sub(r"(\]\()(?!\w+:)", rf"\1{REPOSITORY}/blob/main/", text)


os.umask(0o022)
setup(
    cmdclass={"build_py": Packages, "sdist": Source},
    long_description=_readme(),
    long_description_content_type="text/markdown",
)
