"""The settings of a jail; tests/jails runs programs in one."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from experiment_runner.competition.jail import check_engine, check_image, jail, user_of
from experiment_runner.competition.settings import Limits
from experiment_runner.competition.starting import Launch
from glue.errors import ConfigError

PLACE = Launch(Path("/run/1000/easy-alice-0"), "easy/alice/0", Path("log"), "spring")


def test_every_door_is_shut() -> None:
    made = jail(Limits(memory=2**30, cpus=1.5, pids=100, tmp=2**20, shm=2**21), PLACE, "1000:1000")
    assert made["Env"] == ["GLUE_HUB=ipc:///run/glue/hub", "GLUE_SESSION=easy/alice/0"]
    assert made["User"] == "1000:1000"
    assert made["Labels"] == {"glue.competition": "spring"}
    host = made["HostConfig"]
    assert host["NetworkMode"] == "none"
    (mount,) = host["Mounts"]
    assert (mount["Source"], mount["Target"]) == ("/run/1000/easy-alice-0", "/run/glue")
    assert mount["ReadOnly"] is host["Init"] is host["ReadonlyRootfs"] is True
    assert host["CapDrop"] == ["ALL"]
    assert host["Memory"] == host["MemorySwap"] == 2**30
    assert host["NanoCpus"] == 1_500_000_000
    assert host["PidsLimit"] == 100
    assert host["ShmSize"] == 2**21
    assert host["Tmpfs"] == {"/tmp": "size=1048576,mode=1777,nosuid,nodev,noexec"}
    assert host["SecurityOpt"][0] == "no-new-privileges"


def test_the_seccomp_profile_is_text_for_docker_and_a_path_for_podman() -> None:
    docker, podman = (
        jail(Limits(), PLACE, "1000:1000", podman)["HostConfig"]["SecurityOpt"][1].removeprefix("seccomp=")
        for podman in (False, True)
    )
    assert docker == Path(podman).read_text()
    rules = json.loads(docker)["syscalls"]
    allowed = {name for rule in rules if rule["action"] == "SCMP_ACT_ALLOW" for name in rule["names"]}
    assert {"read", "mmap", "execve", "recvmsg"} <= allowed
    families = [rule["args"][0]["value"] for rule in rules if "socket" in rule["names"]]
    assert families == [1, 2, 10, 16]
    assert not allowed & {
        "socketcall",
        "io_uring_setup",
        "ptrace",
        "unshare",
        "setns",
        "mount",
        "bpf",
        "keyctl",
    }


@pytest.mark.parametrize(
    ("declared", "user"),
    [("1000", "1000:1000"), ("1000:100", "1000:100"), ("1000:0", "1000:0"), ("4294967295", None)]
    + [
        (root, None)
        for root in ("", "0", "0:1000", "root", "00", "+0", "0x0", "glue", "1000:staff", "1000\n")
    ],
)
def test_a_user_is_a_number_and_never_root(declared: str, user: str | None) -> None:
    assert user_of(declared) == (user or "65534:65534", user is not None)


def test_an_image_that_runs_as_root_is_warned_of() -> None:
    warning = check_image("alice/agent:1", {"User": "", "Cmd": ["agent"]})
    assert warning is not None
    assert "alice/agent:1 is to run as root" in warning
    assert "USER 1000" in warning
    assert check_image("alice/agent:1", {"User": "1000", "Entrypoint": ["agent"]}) is None


def test_an_image_that_would_write_to_a_disk_is_refused() -> None:
    with pytest.raises(ConfigError, match="declares a volume, /data, in which it could fill"):
        check_image("alice/agent:1", {"User": "1000", "Cmd": ["agent"], "Volumes": {"/data": {}}})


def test_an_image_without_a_program_is_refused() -> None:
    with pytest.raises(ConfigError, match="nothing to run: add CMD"):
        check_image("alice/agent:1", {"User": "1000", "Cmd": None, "Entrypoint": None})


def test_an_engine_that_cannot_limit_is_refused() -> None:
    able = {"MemoryLimit": True, "PidsLimit": True, "CpuCfsQuota": True}
    check_engine(able, "unix:///run/docker.sock")
    with pytest.raises(ConfigError, match="cannot limit memory, processors"):
        check_engine(able | {"MemoryLimit": False, "CpuCfsQuota": False}, "unix:///run/docker.sock")
