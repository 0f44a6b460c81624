"""Tars of docker save: what of them reaches the engine, and what is refused before that."""

from __future__ import annotations

import bz2
import gzip
import io
import json
import platform
import tarfile
from collections.abc import Mapping
from typing import Any

import pytest

from experiment_runner.competition.season.images import UnfitImage, copy_image
from glue.errors import ConfigError

MOST = 2**20
PROCESSOR = {"x86_64": "amd64", "aarch64": "arm64"}.get(platform.machine(), platform.machine())


def tar(files: Mapping[str, bytes | tarfile.TarInfo]) -> bytes:
    """Return a tar of files, and of members that are something else."""
    written = io.BytesIO()
    with tarfile.open(fileobj=written, mode="w", format=tarfile.GNU_FORMAT) as archive:
        for name, content in files.items():
            if isinstance(content, tarfile.TarInfo):
                archive.addfile(content)
            else:
                member = tarfile.TarInfo(name)
                member.size = len(content)
                archive.addfile(member, io.BytesIO(content))
    return written.getvalue()


def link(name: str, target: str) -> tarfile.TarInfo:
    member = tarfile.TarInfo(name)
    member.type, member.linkname = tarfile.SYMTYPE, target
    return member


LAYER = tar({"agent.py": b"print('hello')" * 100})


def config(**changes: Any) -> bytes:
    found = {"os": "linux", "architecture": PROCESSOR, "config": {"Cmd": ["agent"]}, **changes}
    return json.dumps(found).encode()


def image(
    layers: Mapping[str, bytes | tarfile.TarInfo] | None = None,
    settings: bytes | None = None,
    more: Mapping[str, bytes] | None = None,
    tags: list[str] | None = None,
) -> dict[str, bytes | tarfile.TarInfo]:
    """Return the files of an image as docker save writes them."""
    layers = {"one/layer.tar": LAYER} if layers is None else layers
    manifest = [{"Config": "abc.json", "RepoTags": tags or ["alice/agent:1"], "Layers": list(layers)}]
    return {
        **layers,
        "abc.json": settings or config(),
        "manifest.json": json.dumps(manifest).encode(),
        **(more or {}),
    }


def copied(files: Mapping[str, bytes | tarfile.TarInfo], most: int = MOST) -> dict[str, bytes]:
    """Return the files of the copy."""
    target = io.BytesIO()
    copy_image(io.BytesIO(tar(files)), target, most)
    target.seek(0)
    with tarfile.open(fileobj=target) as archive:
        found = {}
        for member in archive:
            file = archive.extractfile(member)
            assert file is not None
            found[member.name] = file.read()
        return found


def test_an_image_keeps_its_bytes_and_loses_its_names() -> None:
    more = {"repositories": b'{"glue-hub": {"latest": "x"}}', "index.json": b"{}", "oci-layout": b"{}"}
    found = copied(image(more=more, tags=["glue-hub:latest", "python:3.11"]))
    assert found.keys() == {"0.tar", "config.json", "manifest.json"}
    assert found["0.tar"] == LAYER
    assert found["config.json"] == config()
    assert json.loads(found["manifest.json"]) == [
        {"Config": "config.json", "RepoTags": None, "Layers": ["0.tar"]}
    ]


def test_a_layer_of_gzip_stays_one() -> None:
    packed = gzip.compress(LAYER)
    assert copied(image({"blobs/sha256/1": packed}))["0.tar"] == packed


def test_a_layer_that_is_there_already_is_a_link() -> None:
    found = copied(
        image({"one/layer.tar": LAYER, "two/layer.tar": link("two/layer.tar", "../one/layer.tar")})
    )
    assert found["0.tar"] == found["1.tar"] == LAYER


def header(size: bytes, kind: bytes = b"0", more: bytes = b"") -> bytes:
    """Return the header of a member with this size, as it is written in 12 bytes, and more from byte 386."""
    made = bytearray(tarfile.TarInfo("some").tobuf(tarfile.GNU_FORMAT))
    made[124:136], made[156:157], made[386 : 386 + len(more)] = size, kind, more
    made[148:156] = b" " * 8
    made[148:156] = b"%06o\0 " % sum(made)
    return bytes(made)


def part(kind: bytes, content: bytes) -> bytes:
    """Return a member of this kind with its content."""
    return header(b"%011o\0" % len(content), kind) + content + bytes(-len(content) % 512)


def pax_sparse() -> bytes:
    """Return a tar with a sparse file of 64 GiB, in the format of PAX."""
    member = tarfile.TarInfo("huge")
    member.pax_headers = {"GNU.sparse.size": f"{2**36}", "GNU.sparse.map": "0,0"}
    return member.tobuf(tarfile.PAX_FORMAT) + bytes(1024)


LONG_NAMES = (header(b"%011o\0" % 2, b"L") + b"a".ljust(512, b"\0")) * 3000
HUGE = (b"%011o\0" % 0 * 2).ljust(97, b"\0") + b"\x80" + (2**36).to_bytes(11, "big")
"""What the old format of GNU says of a sparse file of 64 GiB."""

EMPTY = header(b"%011o\0" % 0)
COVERED = part(b"0", pax_sparse())
"""A file with another in it, for whoever takes its header for the content of an earlier file."""

COVER = b"15 size=%06d\n" % (len(COVERED) - 512)
NESTED = "/".join("folder" for _ in range(50))


@pytest.mark.parametrize(
    ("layer", "why"),
    [
        (gzip.compress(tar({"zeros": bytes(2 * MOST)})), "too large"),
        (gzip.compress(bytes(2 * MOST)), "too large"),
        (header(b"%011o\0" % 0, b"S", HUGE) + bytes(1024), "sparse file"),
        (pax_sparse(), "sparse file"),
        (header(b"\xff" * 10 + b"\xfe\x00"), "read differently"),
        (header(b"%011o\0" % 0, b"g") + LAYER, "global header"),
        (LAYER[:2048] + header(b"12x4567890\0\0") + bytes(1024), "a layer is not as docker save"),
        (LONG_NAMES, "a layer is not as docker save"),
        (part(b"L", b"folder/") + part(b"\0", pax_sparse()), "read differently"),
        (part(b"x", b"16 path=folder/\n") + part(b"\0", pax_sparse()), "read differently"),
        (part(b"X", COVER) + EMPTY + pax_sparse(), "read differently"),
        (part(b"x", b"8 size=\n") + header(b"%011o\0" % 512) + COVERED, "read differently"),
        (header(b"\0%010o\0" % 512) + COVERED, "read differently"),
        (part(b"x", COVER) + part(b"x", b"13 comment=a\n") + EMPTY + pax_sparse(), "read differently"),
        (part(b"x", b"9 path=ab\n") + EMPTY, "read differently"),
        (tar({".wh..wh.plnk/1": b""}), "read differently"),
        (tar({f"{number}/{NESTED}": b"" for number in range(10)}), "too large"),
        (tar({"\x50\x2a\x4d\x18": b""}), "not by gzip"),
        (tar({f"{number}": b"" for number in range(300)}), "too large"),
        (bz2.compress(LAYER), "not by gzip"),
        (b"no tar at all" * 100, "a layer is not as docker save"),
        (gzip.compress(LAYER)[:100], "a layer is not as docker save"),
    ],
    ids=[
        *("bomb", "zeros", "sparse", "sparse by PAX", "negative", "global", "broken", "long names"),
        *("folder with data", "folder by PAX", "kind", "no size by PAX", "zero before a size"),
        *("two of PAX", "broken PAX", "copied links", "folders", "zstd", "many files", "bzip2"),
        *("text", "cut"),
    ],
)
def test_a_layer_that_cannot_be_counted_or_takes_too_much_is_refused(layer: bytes, why: str) -> None:
    with pytest.raises(UnfitImage, match=why):
        copied(image({"one/layer.tar": layer}))


def test_all_layers_count_together() -> None:
    for layer in (tar({"file": bytes(2**18)}), gzip.compress(LAYER + bytes(2**18))):
        layers: dict[str, bytes | tarfile.TarInfo] = {f"{number}/layer.tar": layer for number in range(5)}
        with pytest.raises(UnfitImage, match="more than 1 MiB"):
            copied(image(layers))
        assert len(copied(image(layers), 2 * MOST)) == 7


@pytest.mark.parametrize("form", [tarfile.USTAR_FORMAT, tarfile.GNU_FORMAT, tarfile.PAX_FORMAT])
def test_layers_in_every_usual_format_are_taken_and_a_folder_counts_once(form: int) -> None:
    folders = "/".join("folder" for _ in range(20))
    records = {"mtime": "1.5", "SCHILY.xattr.user.size": "7 size=1"} if form == tarfile.PAX_FORMAT else {}
    written = io.BytesIO()
    with tarfile.open(fileobj=written, mode="w", format=form, pax_headers={}) as archive:
        for number in range(100):
            member = tarfile.TarInfo(f"{folders}/{number}" + "x" * 50)
            member.size, member.pax_headers = 1000, records
            archive.addfile(member, io.BytesIO(bytes(1000)))
        hard = tarfile.TarInfo("link")
        hard.type, hard.linkname = tarfile.LNKTYPE, "folder/" * (5 if form == tarfile.USTAR_FORMAT else 20)
        archive.addfile(hard)
    assert copied(image({"one/layer.tar": written.getvalue()}), 4096 * (100 + 20 + 1) + 100 * 1000)


@pytest.mark.parametrize(
    ("files", "why"),
    [
        ({}, "no manifest.json"),
        ({"manifest.json": b"["}, "not JSON"),
        ({"manifest.json": b"[" * 100_000}, "not JSON"),
        ({"manifest.json": b"[]"}, "does not hold one image"),
        ({"manifest.json": b"[{},{}]"}, "does not hold one image"),
        ({"manifest.json": b"[{}]"}, "is not that of an image"),
        ({"manifest.json": bytes(2**23)}, "more than"),
        (image({"../../etc/passwd": link("../../etc/passwd", "/etc/passwd")}), "has no"),
        (image({"one": link("one", "two"), "two": link("two", "one")}), "has no"),
        (image(settings=b"{}"), "its configuration"),
        ({f"{number}": b"" for number in range(1200)}, "more than 1,000 parts"),
    ],
)
def test_what_is_no_image_is_refused(files: dict[str, bytes | tarfile.TarInfo], why: str) -> None:
    with pytest.raises(UnfitImage, match=why):
        copied(files)


@pytest.mark.parametrize(
    ("settings", "why"),
    [
        (config(architecture="s390x"), "for the platform"),
        (config(config={"Cmd": ["a"], "Volumes": {"/data": {}}}), "VOLUME"),
        (config(config={"Cmd": ["a"], "volumeſ": {"/data": {}}}), "VOLUME"),
        (config(config={"Cmd": ["a"], "Volumes": 5}), "not that of an image"),
        (config(Config={"Volumes": {"/data": {}}}), "in case alone"),
        (
            config(config={"Cmd": ["a"]}).replace(b'"os"', b'"config": {"Volumes": {"/data": {}}}, "os"'),
            "twice",
        ),
        (config(config={"Env": []}), "nothing to run"),
    ],
)
def test_an_image_that_could_not_be_jailed_is_refused(settings: bytes, why: str) -> None:
    with pytest.raises(ConfigError, match=why):
        copied(image(settings=settings))


@pytest.mark.parametrize(
    ("data", "why"),
    [
        *((data, ".") for data in (b"", b"\0" * 5000, b"hello" * 1000, tar(image())[:700])),
        (LONG_NAMES, "docker save"),
        (header(b"%011o\0" % 0) * 1100, "1,000 parts"),
    ],
)
def test_what_is_no_tar_is_refused_and_none_is_read_for_ever(data: bytes, why: str) -> None:
    with pytest.raises(UnfitImage, match=why):
        copy_image(io.BytesIO(data), io.BytesIO(), MOST)


def test_a_full_disk_is_no_fault_of_the_image() -> None:
    with open("/dev/full", "wb", buffering=0) as full, pytest.raises(OSError, match="No space left"):
        copy_image(io.BytesIO(tar(image())), full, MOST)
