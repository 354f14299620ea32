"""Launches as users start them: every shipped file comes to decisions, failures have names, nobody is left behind."""

from __future__ import annotations

import os
import signal
import socket
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from launching import Ear, launched, on_loopback, without_spares

from twin_node.bag import open_log
from twin_node.bench.graph_run import free_endpoint
from twin_node.cell import load_scenario
from twin_node.cell.rig import make_rig
from twin_node.cell.ur_sim import free_loopback
from twin_node.cli import main
from twin_node.errors import TwinError
from twin_node.messages import convert
from twin_node.nodes.launch.launch_file import LaunchPlan, read_launch_file
from twin_node.nodes.launch.launcher import FIRST_STATUS, Launcher
from twin_node.nodes.topics import DIAGNOSTICS, SEPARATION
from twin_node.rig import RigFile, save_rig
from twin_node.scene import Rig, RigCamera

pytest.importorskip("zenoh")

QUICK = ["synchronizer.width:=48", "synchronizer.max_rate_hz:=4.0", "size.name:=given", "model.seed.steps:=8"]
"""Parameters that make the twin start soon on a busy machine."""


def is_of_evidence(message: object) -> bool:
    return convert.separation_from_message(message).evidence_stamp > 0


def decides(plan: LaunchPlan, logs: Path, endpoint: str) -> None:
    """Asserts that a launch comes to speed decisions by evidence, and that its end leaves no process."""
    with launched(without_spares(on_loopback(plan, endpoint)), logs) as running:
        with Ear(endpoint) as ear:
            ear.hear(SEPARATION, is_of_evidence)
        children = running.launcher.children()
        assert set(children) == {process.name for process in plan.processes}
        assert running.stop().status == 0
    assert not any(is_alive(pid) for pid in children.values())


def is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_replay(cell_log: Callable[..., Path], tmp_path: Path) -> None:
    arguments = [f"log:={cell_log(1.2)}", "rate:=0.1"]  # begins anew after 12 s: by then a twin has loaded
    plan = read_launch_file("launch/replay.yaml", arguments, [*QUICK, "player.loop:=true"])
    decides(plan, tmp_path, free_endpoint())


def test_sim_cell_with_a_driver_and_its_controller(tmp_path: Path) -> None:
    pytest.importorskip("rtde_io", reason="ur_rtde is not installed")
    plan = read_launch_file("launch/sim_cell.yaml", [f"host:={free_loopback()}"], [*QUICK, "size.name:=auto"])
    decides(plan, tmp_path, free_endpoint())


def test_two_machines(tmp_path: Path) -> None:
    twins, cameras = free_endpoint(), free_endpoint()
    scenario = ["scenario:=demo", "source:=cell"]
    twin = read_launch_file("launch/two_machines.yaml", ["role:=twin", f"listen:={twins}", *scenario], QUICK)
    far = read_launch_file("launch/two_machines.yaml", ["role:=cameras", f"join:={twins}", *scenario])
    with launched(without_spares(on_loopback(far, cameras)), tmp_path / "far"):
        decides(twin, tmp_path / "near", twins)


def test_oak_rig_on_host_nodes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The launch file as it ships; another package's entry point puts host nodes in the place of the devices."""
    pytest.importorskip("depthai")
    package = tmp_path / "packages" / "host_cameras-1.dist-info"
    package.mkdir(parents=True)
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: host_cameras\nVersion: 1\n")
    (package / "entry_points.txt").write_text("[twin_node.nodes]\ncameras = host_cameras:make_cameras\n")
    here = Path(__file__).parent
    paths = [str(package.parent), str(here), str(here.parent / "rig" / "cameras")]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(paths))
    scene = load_scenario("demo")
    cameras = [twice_as_large(c, n) for c, n in zip(make_rig(scene).cameras, ("front", "left", "right"), strict=True)]
    save_rig(RigFile(Rig(tuple(cameras), np.array(scene.workspace))), tmp_path / "rig.yaml")
    plan = read_launch_file("launch/oak_rig.yaml", [f"rig:={tmp_path / 'rig.yaml'}"], QUICK)
    decides(plan, tmp_path, free_endpoint())


def twice_as_large(camera: RigCamera, name: str) -> RigCamera:
    """The camera under another name, with images of twice the size."""
    scale = np.diag([2.0, 2.0, 1.0])
    return replace(camera, name=name, width=2 * camera.width, height=2 * camera.height, K=scale @ camera.K)


def test_lockstep_gives_the_bytes_of_replay(cell_log: Callable[..., Path], tmp_path: Path) -> None:
    log, ours, theirs = cell_log(1.2), tmp_path / "launch.mcap", tmp_path / "replay.mcap"
    given = [f"log:={log}", f"output:={ours}", "lockstep:=true", "duration:=0.5", "--log-dir", str(tmp_path)]
    width = ["-p", "synchronizer.width:=64"]
    assert main(["launch", "launch/replay.yaml", *given, *width]) == 0
    assert main(["replay", str(log), "-o", str(theirs), "--lockstep", "--duration", "0.5", "--width", "64"]) == 0
    assert ours.read_bytes() == theirs.read_bytes()


ARM_ALONE = """
launch:
  processes:
    write: {nodes: [recorder]}
    arm: {nodes: [arm], restart: RESTART, spare: SPARE}
/**:
  ros__parameters: {rig: {scenario: demo}}
recorder:
  ros__parameters: {output: OUTPUT, topics: [/twin/separation]}
arm:
  ros__parameters: {model: ur5e}
"""


def arm_alone(folder: Path, restart: str, spare: str = "false") -> LaunchPlan:
    path = folder / "arm.yaml"
    text = ARM_ALONE.replace("RESTART", restart).replace("SPARE", spare).replace("OUTPUT", str(folder / "out"))
    path.write_text(text)
    return read_launch_file(path)


@pytest.mark.parametrize("spare", ["false", "true"])
def test_a_killed_process_is_started_again_and_the_arm_stands_meanwhile(tmp_path: Path, spare: str) -> None:
    endpoint = free_endpoint()
    with launched(on_loopback(arm_alone(tmp_path, "true", spare), endpoint), tmp_path) as running:
        with Ear(endpoint) as ear:
            ear.hear(SEPARATION, lambda message: running.launcher.is_whole)
            killed, standing_by = running.launcher.children()["arm"], running.launcher.spares().get("arm")
            os.kill(killed, signal.SIGKILL)
            ear.hear(DIAGNOSTICS, lambda message: running.launcher.children().get("arm", killed) != killed)
            told = convert.separation_from_message(ear.hear(SEPARATION, lambda message: True))
        assert told.speed_fraction == 0.0
        assert (running.launcher.children()["arm"] == standing_by) == (spare == "true")
        assert running.stop().restarts == 1
    assert any("arm: killed by signal 9; starting it again" in line for line in running.said)
    with open_log(tmp_path / "out") as log:
        assert log.damage is None
        assert [topic.name for topic in log.topics] == [SEPARATION]


def test_a_process_that_is_started_again_and_refuses_is_tried_again(tmp_path: Path) -> None:
    """A file, a camera or a disk that is away for a moment ends no launch."""
    rig, away, endpoint = tmp_path / "rig.yaml", tmp_path / "away.yaml", free_endpoint()
    save_rig(RigFile(make_rig(load_scenario("demo"))), rig)
    plan = on_loopback(arm_alone(tmp_path, "true"), endpoint)
    plan = replace(plan, sections={**plan.sections, "/**": {"rig": {"file": str(rig)}}})
    with launched(plan, tmp_path) as running:
        with Ear(endpoint) as ear:
            ear.hear(SEPARATION, lambda message: running.launcher.is_whole)
            rig.rename(away)
            os.kill(running.launcher.children()["arm"], signal.SIGKILL)
            ear.hear(DIAGNOSTICS, lambda message: running.error is not None or any(map(refused_the_rig, running.said)))
            away.rename(rig)
            ear.hear(DIAGNOSTICS, lambda message: running.error is not None or running.launcher.is_whole)
        assert running.stop().restarts >= 2


def refused_the_rig(line: str) -> bool:
    return line.startswith("arm: failed: ") and "rig.yaml" in line and line.endswith("; starting it again")


def test_a_second_launch_of_the_same_nodes_is_refused(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    plan = on_loopback(arm_alone(tmp_path, "true"), endpoint)
    shared = replace(plan, zenoh=replace(plan.zenoh, router="auto"))
    joined = replace(plan, zenoh=replace(plan.zenoh, endpoint=free_endpoint(), routers=("", endpoint)))
    with launched(plan, tmp_path / "first"):
        with Ear(endpoint) as ear:
            ear.hear(SEPARATION, lambda message: True)
        for again in (shared, joined):  # on this machine, and on another one whose router is joined to this one's
            alive = pytest.raises(TwinError, match=r"node '(recorder|arm)' is alive already in ROS domain 0")
            with launched(again, tmp_path / "second") as running, alive:
                running.wait()
        other = replace(shared, zenoh=replace(shared.zenoh, domain=1))
        with launched(other, tmp_path / "third") as running:
            assert running.stop().status == 0


def test_logs_that_have_no_place_are_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(TwinError, match=r"no folder for logs can be made .*; choose one with --log-dir"):
        Launcher(arm_alone(tmp_path, "true"), tmp_path / "file" / "logs", print).run()


def test_an_address_that_something_else_has_is_refused(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        plan = on_loopback(arm_alone(tmp_path, "true"), f"tcp/127.0.0.1:{taken.getsockname()[1]}")
        with pytest.raises(TwinError, match="what listens is no zenoh router, or the address is wrong"):
            Launcher(replace(plan, zenoh=replace(plan.zenoh, router="auto")), tmp_path, print).run()


def test_the_exit_status_tells_which_process_failed(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with launched(on_loopback(arm_alone(tmp_path, "false"), endpoint), tmp_path) as running:
        with Ear(endpoint) as ear:
            ear.hear(SEPARATION, lambda message: True)
        os.kill(running.launcher.children()["arm"], signal.SIGKILL)
        result = running.wait()
    assert (result.failed, result.status) == ("arm", FIRST_STATUS + 1)


def test_processes_end_when_their_launcher_is_killed(tmp_path: Path) -> None:
    """As after `kill -9`: the ends of their pipes close, and they bring themselves down."""
    endpoint = free_endpoint()
    with launched(on_loopback(arm_alone(tmp_path, "true"), endpoint), tmp_path) as running:
        with Ear(endpoint) as ear:
            ear.hear(SEPARATION, lambda message: True)
        child = running.launcher._children["write"]
        child._process.stdin.close()
        assert child._process.wait(60) == 0


def test_a_node_that_refuses_its_parameters_ends_the_launch_before_anything_is_active(tmp_path: Path) -> None:
    plan = on_loopback(arm_alone(tmp_path, "true"), free_endpoint())
    sections = {**plan.sections, "arm": {"model": "ur5e", "modle": "ur3e"}}
    with (
        launched(replace(plan, sections=sections), tmp_path) as running,
        pytest.raises(TwinError, match="unknown parameter 'modle'; did you mean 'model'"),
    ):
        running.wait()
    assert not any(line.startswith("active") for line in running.said)
