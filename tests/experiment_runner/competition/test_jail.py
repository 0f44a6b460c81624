"""The settings of a jail; tests/jails runs programs in one."""

from __future__ import annotations

import json
from contextlib import ExitStack
from pathlib import Path

import pytest

from experiment_runner.competition.jail import check_engine, check_image, check_limits, jail, own_user
from experiment_runner.competition.launching import Launch
from experiment_runner.competition.settings import Limits
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
    limits = {limit["Name"]: limit["Hard"] for limit in host["Ulimits"]}
    assert limits["msgqueue"] == limits["core"] == 0
    assert {"sigpending", "nofile"} <= limits.keys()


def test_of_sys_a_jail_sees_the_list_of_processors_and_its_own_control_group() -> None:
    masked = jail(Limits(), PLACE, "1000:1000")["HostConfig"]["MaskedPaths"]
    assert {"/proc/loadavg", "/proc/sys/fs", "/sys/devices/system/cpu/cpu0"} <= set(masked)
    hidden = [Path(path) for path in masked if path.startswith("/sys/")]
    seen = [path for path in Path("/sys/devices/system").iterdir() if path not in hidden]
    assert seen == [Path("/sys/devices/system/cpu")]
    assert not any(
        Path(shown).is_relative_to(path) for shown in ("/sys/fs/cgroup", *map(str, seen)) for path in hidden
    )


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
    assert not allowed & {"socketcall", "io_uring_setup", "ptrace", "unshare", "setns", "mount", "bpf"}
    assert "keyctl" not in allowed


def test_no_two_jails_have_the_same_user_at_the_same_time() -> None:
    with ExitStack() as stack:
        users = [stack.enter_context(own_user()) for _ in range(20)]
    assert len(set(users)) == 20
    assert all(user.split(":")[0] == user.split(":")[1] != "0" for user in users)


def test_a_giant_image_is_warned_of() -> None:
    settings = {"User": "", "Cmd": ["agent"]}
    assert check_image("alice/agent:1", settings, 2**30) is None
    assert "alice/agent:1 takes 12.0 GiB" in str(check_image("alice/agent:1", settings, 12 * 2**30))


def test_more_processors_than_there_are_cannot_be_promised() -> None:
    check_limits(Limits(cpus=2.0), 2)
    with pytest.raises(ConfigError, match=r"cpus = 64, but this machine has only 2"):
        check_limits(Limits(cpus=64.0), 2)


def test_an_engine_that_cannot_limit_is_refused() -> None:
    able = {"MemoryLimit": True, "PidsLimit": True, "CpuCfsQuota": True}
    check_engine(able, "unix:///run/docker.sock")
    with pytest.raises(ConfigError, match="cannot limit memory, processors"):
        check_engine(able | {"MemoryLimit": False, "CpuCfsQuota": False}, "unix:///run/docker.sock")
