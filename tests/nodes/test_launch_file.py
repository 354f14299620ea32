"""Launch files: arguments, conditions, parameters, and what is refused."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from twin_node.errors import TwinError
from twin_node.nodes.chain_parameters import ChainParameters, load_parameters
from twin_node.nodes.launch.launch_file import in_one_process, read_arguments, read_launch_file, remapped

SMALL = """
launch:
  arguments:
    log: {help: what to play}
    rate: {default: 1.0}
    loop: {default: false}
    who: {default: twin}
    how: {default: fast, choices: [fast, slow]}
  processes:
    play: {nodes: [player], ends_launch: true, restart: false}
    arm: {nodes: [arm], if: $(var who)/x == twin/x, nice: 5}
    write: {nodes: [recorder], if: $(var loop)}
player:
  ros__parameters: {log: $(var log), rate: $(var rate), remap: ["/a:=/$(var who)"]}
"""


@pytest.fixture
def small(tmp_path: Path) -> Path:
    path = tmp_path / "small.yaml"
    path.write_text(SMALL)
    return path


def test_arguments_fill_values_of_their_own_type(small: Path) -> None:
    plan = read_launch_file(small, ["log:=a.mcap", "rate:=2"])
    assert plan.sections["player"] == {"log": "a.mcap", "rate": 2.0, "remap": ["/a:=/twin"]}
    assert [(p.name, p.nodes, p.restarts, p.ends_launch, p.niceness) for p in plan.processes] == [
        ("play", ("player",), False, True, 0),
        ("arm", ("arm",), True, False, 5),
    ]


@pytest.mark.parametrize(("text", "rate"), [("5e-1", 0.5), ("1e2", 100.0), (".25", 0.25)])
def test_a_number_may_have_an_exponent_without_a_point(small: Path, text: str, rate: float) -> None:
    """YAML takes it for text, Python writes numbers so: `sim SCENARIO --duration 1e-5` was not to be a number."""
    assert read_launch_file(small, ["log:=a", f"rate:={text}"]).sections["player"]["rate"] == rate


def test_conditions_choose_processes(small: Path) -> None:
    plan = read_launch_file(small, ["log:=a", "who:=nobody", "loop:=true"])
    assert [(p.name, p.place) for p in plan.processes] == [("play", 0), ("write", 2)]


def test_parameters_of_the_command_line_go_into_their_sections(small: Path) -> None:
    plan = read_launch_file(small, ["log:=a"], ["player.rate:=0.5", "arm.limiter.deadline_s:=0.2"])
    assert plan.sections["player"]["rate"] == 0.5
    assert plan.sections["arm"] == {"limiter": {"deadline_s": 0.2}}


@pytest.mark.parametrize(("compared", "runs"), [("true", True), ("True", True), ("false", False), ("False", False)])
def test_an_argument_that_is_true_or_false_is_compared_as_yaml_has_it(small: Path, compared: str, runs: bool) -> None:
    """`if: $(var loop) == true` never held, for within a text the argument is `True`."""
    text = small.read_text()
    small.write_text(text.replace("if: $(var loop)}", f"if: $(var loop) == {compared}}}"))
    for loop in (True, False):
        plan = read_launch_file(small, ["log:=a", f"loop:={str(loop).lower()}"])
        assert ("write" in [process.name for process in plan.processes]) == (loop is runs)


@pytest.mark.parametrize(
    ("arguments", "parameters", "words"),
    [
        ([], [], r"needs log:=VALUE \(log: what to play\)"),
        (["log:=a", "rat:=2"], [], "unknown argument 'rat'; did you mean 'rate'"),
        (["log:=a", "rate:=fast"], [], "rate:=fast: expected a number"),
        (["log:=a", "rate:=nan"], [], "rate:=nan: expected a number"),
        (["log:=a", f"rate:={'9' * 400}"], [], "9: expected a number"),
        (["log=a"], [], "expected NAME:=VALUE"),
        (["log:=a", "how:=slowly"], [], "small.yaml: argument how: expected one of fast, slow, found 'slowly'"),
        (["log:=a"], ["rate:=2"], "expected NODE.KEY:=VALUE"),
        (["log:=a"], ["plaier.rate:=2"], "unknown node 'plaier'; did you mean 'player'"),
        (["log:=a"], ["twin.x:=1"], r"has no node 'twin'; it has arm, player, recorder"),
        (["log:=a"], ["cell.duration:=5"], "-p cell.duration:=5: .* has no node 'cell'; it has arm, player, recorder"),
        (["log:=a", "rate:=["], [], r"rate:=\[: expected a number, found what is no YAML"),
        (["log:=a"], ["player.rate:=["], r"-p player.rate:=\[: expected a value, found what is no YAML"),
        (["log:=a", "loop:=2020-13-45"], [], "loop:=2020-13-45: expected true or false, found what is no YAML"),
        (["log:=a"], [f"player.rate:={'9' * 5000}"], "expected a value, found what is no YAML"),
        (["log:=a"], [f"player.rate:={'[' * 3000}"], "expected a value, found what is no YAML"),
        (["log:=a"], ["player.rate:=&x [*x]"], "expected a value, found what is no YAML"),
        (
            ["log:=a"],
            ["player.log:=2026-11-23"],
            r"11-23\): player.log: expected text .* 2026-11-23 \(a date\)",
        ),
        (["log:=a"], ["player.topics:=[!!binary aGk=]"], r"player.topics: expected text or numbers, found b'hi'"),
        (["log:=a"], ["player.rate.x:=1"], "-p player.rate.x:=1: expected keys and values under 'rate', found 1.0"),
    ],
)
def test_what_the_user_got_wrong_is_named(small: Path, arguments: list[str], parameters: list[str], words: str) -> None:
    with pytest.raises(TwinError, match=words):
        read_launch_file(small, arguments, parameters)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("nodes: [player]", "nodes: [playr]", "unknown node 'playr'; did you mean 'player'"),
        ("restart: false", "restrt: false", "unknown key 'restrt'; did you mean 'restart'"),
        ("  processes:", "  proceses:", "unknown key 'proceses'; did you mean 'processes'"),
        ("launch:", "lunch:", "has no section 'launch'"),
        ("launch:", "launch: 5\nelsewhere:", "launch: expected keys and values, found 5"),
        ("$(var rate)", "$(var ratio)", r"small.yaml: .*ratio.*: no such argument; did you mean 'rate'"),
        ("nodes: [player]", "nodes: []", "expected a list of nodes"),
        ("\nplayer:", "\nsynchroniser:", "unknown node 'synchroniser'"),
        ("{nodes: [player]", "{nodes: [player", "cannot be read as YAML"),
        ("nodes: [player]", "nodes: player", "process 'play': nodes: expected a list, found 'player'"),
        ("nodes: [recorder]", "nodes: 5", "process 'write': nodes: expected a list, found 5"),
        (
            "play: {nodes: [player], ends_launch: true, restart: false}",
            "play: [player]",
            "process 'play': expected keys and values with a list of nodes, found a list",
        ),
        ("    play:", "    a/b:", "process 'a/b': expected a name of letters, digits"),
        ("nodes: [arm]", "nodes: [player]", "node 'player' is in two processes, play and arm"),
        ("nodes: [player]", "nodes: [player, player]", "node 'player' is in process 'play' twice"),
        ("rate: {default: 1.0}", "rate: 1.0", "argument 'rate': expected 'default', 'help' and 'choices', found 1.0"),
        ("{default: twin}", "{default: $(var how)}", r"argument 'who': default: \$\(var how\): no such argument"),
        ("[fast, slow]", "fast", "argument 'how': choices: expected a list of texts, found 'fast'"),
        ("[fast, slow]", "[1, 2]", "argument 'how': choices: expected a list of texts, found a list"),
        ("[fast, slow]", "[slow]", "argument 'how': default: expected one of slow, found 'fast'"),
        ("restart: false", 'restart: "false"', "process 'play': restart: expected true or false, without quotes"),
        ("restart: false", "spare: 1", "process 'play': spare: expected true or false, without quotes, found 1"),
        ("ends_launch: true", "ends_launch: twin", "process 'play': ends_launch: expected true or false"),
        ("nice: 5", "nice: 20", "process 'arm': nice: expected a whole number from 0 to 19, found 20"),
        ("nice: 5", "nice: -1", "process 'arm': nice: expected a whole number from 0 to 19, found -1"),
        ("nice: 5", "nice: true", "process 'arm': nice: expected a whole number from 0 to 19, found True"),
        ("  processes:", '  use_sim_time: "false"\n  processes:', "launch: use_sim_time: expected true or false"),
        ("  processes:", "  lockstep: maybe\n  processes:", "launch: lockstep: expected true or false"),
        ("log: $(var log)", "2026-11-23: $(var log)", "player: a key: expected text or numbers, found 2026-11-23"),
        ("  processes:", "  zenoh: 5\n  processes:", "launch: zenoh: expected keys and values, found 5"),
    ],
)
def test_what_is_wrong_with_the_file_is_named(small: Path, old: str, new: str, words: str) -> None:
    small.write_text(SMALL.replace(old, new, 1))
    with pytest.raises(TwinError, match=words):
        read_launch_file(small, ["log:=a"])


@pytest.mark.parametrize("text", ["processes:", "processes: 5", "processes: [a]", "arguments: [a]"])
def test_a_part_of_the_wrong_kind_is_named(small: Path, text: str) -> None:
    small.write_text(f"launch: {{{text}}}")
    with pytest.raises(TwinError, match=f"small.yaml: .*{text.partition(':')[0]}"):
        read_launch_file(small)


@pytest.mark.parametrize("name", ["replay", "sim_cell", "oak_rig", "two_machines"])
def test_every_launch_file_that_ships_is_whole(name: str) -> None:
    path = f"launch/{name}.yaml"
    needed = [f"{a.name}:=x" for a in read_arguments(path) if a.is_required and a.name != "role"]
    roles = [["role:=twin"], ["role:=cameras"]] if name == "two_machines" else [[]]
    for role in roles:
        assert read_launch_file(path, needed + role).processes


def test_all_nodes_in_one_process(small: Path) -> None:
    [process] = in_one_process(read_launch_file(small, ["log:=a"])).processes
    assert (process.nodes, process.ends_launch, process.restarts) == (("player", "arm"), True, False)
    small.write_text(SMALL.replace(", restart: false", ""))
    assert in_one_process(read_launch_file(small, ["log:=a"])).processes[0].restarts


def test_arguments_have_their_defaults_where_a_launch_file_gives_parameters_alone(small: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.yaml"
    told = "\narm:\n  ros__parameters: {model: $(var arm), joints: [$(var arm)_a]}\n"
    other.write_text(SMALL.replace("who: {default: twin}", "who: {default: twin}\n    arm: {default: ur3e}") + told)
    assert load_parameters(other).arm.model == "ur3e"
    plan = read_launch_file(small, ["log:=a.mcap"], [], [other])
    assert plan.sections["arm"] == {"model": "ur3e", "joints": ["ur3e_a"]}


def test_a_default_may_hold_arguments_that_stand_before_it(small: Path) -> None:
    """They were left as they stand: a recorder wrote into a folder of the name `$(var log)_twin`."""
    held = "{default: $(var rate)}\n    out: {default: $(var log)_$(var who)}"
    small.write_text(SMALL.replace("how: {default: fast, choices: [fast, slow]}", f"pace: {held}"))
    with small.open("a") as file:
        file.write("recorder:\n  ros__parameters: {output: $(var out), split: {max_bag_size: $(var pace)}}\n")
    recorder = read_launch_file(small, ["log:=a", "rate:=2"]).sections["recorder"]
    assert recorder == {"output": "a_twin", "split": {"max_bag_size": 2.0}}
    recorder = read_launch_file(small, ["out:=b", "pace:=5", "log:=a"]).sections["recorder"]
    assert recorder == {"output": "b", "split": {"max_bag_size": 5.0}}


def test_defaults_hold_one_another_where_a_launch_file_gives_parameters_alone(small: Path) -> None:
    arguments = "    size: {default: 3}\n    arm: {default: ur$(var size)e}\n  processes:"
    small.write_text(f"{SMALL}arm:\n  ros__parameters: {{model: $(var arm)}}\n".replace("  processes:", arguments))
    assert load_parameters(small).arm.model == "ur3e"
    small.write_text(small.read_text().replace("ur$(var size)e", "$(var log)"))
    with pytest.raises(TwinError, match="the argument 'log' has no default"):
        load_parameters(small)


@pytest.mark.parametrize("value", ["model: $(var log)", "joints: [a, b_$(var log)]", "limiter: {x: $(var log)}"])
def test_parameters_that_wait_for_an_argument_are_refused_where_none_is_given(value: str, small: Path) -> None:
    small.write_text(f"{SMALL}arm:\n  ros__parameters: {{{value}}}\n")
    words = r"small.yaml: arm: (model|joints|limiter: x): the argument 'log' has no default, .*; write the value"
    with pytest.raises(TwinError, match=words):
        load_parameters(small)


@pytest.mark.parametrize("name", ["sim_cell", "oak_rig", "two_machines"])
def test_whoever_knows_an_arm_in_a_launch_knows_the_one_it_is_given(name: str) -> None:
    given = {"oak_rig": ["rig:=a.yaml", "robot:=10.0.0.2"], "two_machines": ["role:=twin"]}.get(name, [])
    plan = read_launch_file(f"launch/{name}.yaml", [*given, "model:=ur16e"])
    known = {section: values["model"] for section, values in plan.sections.items() if "model" in values}
    assert "arm" in known
    assert set(known.values()) == {"ur16e"}


def test_parameters_that_no_node_reads_are_refused(small: Path, tmp_path: Path) -> None:
    """The twin's own are in the sections of the chain, and those of viewers' topics too."""
    words = r"node 'twin' has no parameters of its own, found width; .* in synchronizer, drift, model"
    given = tmp_path / "given.yaml"
    given.write_text("twin: {ros__parameters: {width: 80}}")
    with pytest.raises(TwinError, match=f"given.yaml: parameters: {words}"):
        read_launch_file(small, ["log:=a"], [], [given])
    with pytest.raises(TwinError, match=f"given.yaml: {words}"):
        load_parameters(given)
    with pytest.raises(TwinError, match=r"with -p twin.width:=80\): parameters: node 'twin' has no parameters"):
        read_launch_file("launch/replay.yaml", ["log:=a"], ["twin.width:=80"])
    given.write_text("twin: {ros__parameters: {}}\nplayer: {ros__parameters: {log: a}}\n/**: {ros__parameters: {}}")
    assert load_parameters(given) == ChainParameters()
    given.write_text("modle: {ros__parameters: {}}")
    with pytest.raises(TwinError, match=r"given.yaml: unknown node 'modle'; did you mean 'model'\?"):
        load_parameters(given)


def test_what_is_said_of_every_node_and_no_node_has_is_refused(small: Path) -> None:
    """A misspelt model of the arm left the default, in silence."""
    given = small.with_name("given.yaml")
    for key, hint in (
        ("kinematcs: my.yaml", "did you mean 'kinematics'"),
        ("whatever: 1", "write it into the section of its node"),
    ):
        given.write_text(f"/**: {{ros__parameters: {{rig: {{scenario: demo}}, {key}}}}}")
        words = rf"/\*\*: unknown parameter '{key.partition(':')[0]}', which no node has; {hint}"
        with pytest.raises(TwinError, match=words):
            read_launch_file(small, ["log:=a"], [], [given])
        with pytest.raises(TwinError, match=words):
            load_parameters(given)
    given.write_text("/**: {ros__parameters: {robot: 127.0.0.1, delay: 1.0, output: x, model: ur5e}}")
    assert read_launch_file(small, ["log:=a"], [], [given]).sections["/**"]["robot"] == "127.0.0.1"


@pytest.mark.parametrize("told", [True, False])
def test_time_is_that_of_the_clock_where_parameters_of_every_node_say_so(small: Path, told: bool) -> None:
    small.write_text(SMALL.replace("  processes:", f"  use_sim_time: {not told}\n  processes:", 1))
    assert read_launch_file(small, ["log:=a"]).follows_clock is not told
    assert read_launch_file(small, ["log:=a"], [f"/**.use_sim_time:={told}"]).follows_clock is told
    with pytest.raises(TwinError, match=r"/\*\*: use_sim_time: expected true or false"):
        read_launch_file(small, ["log:=a"], ["/**.use_sim_time:=1"])


def test_topics_of_all_nodes_are_renamed(small: Path) -> None:
    plan = remapped(read_launch_file(small, ["log:=a"]), ["joint_states:=/ur/joint_states", "/left/image_raw:=/l/rgb"])
    assert plan.remaps == {"/joint_states": "/ur/joint_states", "/left/image_raw": "/l/rgb"}


def test_images_are_renamed_whatever_the_rig_calls_them(small: Path) -> None:
    """`doctor` advised such a remap, and the launch refused it."""
    rig = "{image: rgb/image_color, depth: '/{camera}/range'}"
    small.write_text(f"{SMALL}/**: {{ros__parameters: {{rig: {rig}}}}}\n")
    remaps = ["/left/rgb/image_color:=/l/rgb", "/left/range:=/l/range"]
    assert len(remapped(read_launch_file(small, ["log:=a"]), remaps).remaps) == 2
    for other in ("/left/image_color", "/left/rgb/image_colour", "/left/right/range"):
        with pytest.raises(TwinError, match=f"no node has the topic {other}"):
            remapped(read_launch_file(small, ["log:=a"]), [f"{other}:=/l/rgb"])


@pytest.mark.parametrize(
    ("remap", "words"),
    [
        ("/joint_state:=/a", "no node has the topic /joint_state; did you mean /joint_states?"),
        ("/joint_states", "expected FROM:=TO"),
        ("/joint_states:=/ur*", "--remap /joint_states:=/ur*: expected a topic's name"),
        ("/joint_states:=/ur#1/q", "without blanks, empty parts and any of *$?#%, found '/ur#1/q'"),
        ("/joint_states:=/a//b", "without blanks, empty parts and any of *$?#%, found '/a//b'"),
        ("/joint_states:=/", "without blanks, empty parts and any of *$?#%, found '/'"),
        ("/tf:=/twin/status", "expected a name for tf2_msgs/msg/TFMessage alone, found that of /twin/status"),
        ("/joint_states:=my joints", "without blanks, empty parts and any of *$?#%, found 'my joints'"),
    ],
)
def test_a_remap_that_changes_nothing_is_refused(small: Path, remap: str, words: str) -> None:
    with pytest.raises(TwinError, match=re.escape(words)):
        remapped(read_launch_file(small, ["log:=a"]), [remap])


def test_all_nodes_are_put_into_a_namespace(small: Path, tmp_path: Path) -> None:
    plan = read_launch_file(small, ["log:=a"])
    assert plan.zenoh.namespace == remapped(plan, ["/joint_states:=/a"]).zenoh.namespace == "/"
    placed = remapped(plan, ["__ns:=/first", "/joint_states:=/a", "__ns:=/cell"])
    assert placed.zenoh.namespace == "/cell", "the last one, as ROS has it"
    assert placed.remaps == {"/joint_states": "/a"}
    file = tmp_path / "placed.yaml"
    file.write_text(small.read_text().replace("launch:\n", "launch:\n  zenoh: {namespace: /line/cell}\n", 1))
    assert read_launch_file(file, ["log:=a"]).zenoh.namespace == "/line/cell"
    with pytest.raises(TwinError, match=r"namespace: expected one such as /cell, .* found 'cell'"):
        remapped(plan, ["__ns:=cell"])


def test_lockstep_has_nobody_to_show_a_page() -> None:
    with pytest.raises(TwinError, match=r"process 'page': node 'viewer' has no part in lockstep, .*; leave it out"):
        read_launch_file("launch/replay.yaml", ["log:=a", "lockstep:=true", "viewer:=true"])


def test_lockstep_has_nothing_to_rename() -> None:
    plan = read_launch_file("launch/replay.yaml", ["log:=a", "lockstep:=true"])
    with pytest.raises(TwinError, match="in lockstep there is no graph"):
        remapped(plan, ["/joint_states:=/a"])
    with pytest.raises(TwinError, match="namespace: expected where there is a graph"):
        remapped(plan, ["__ns:=/a"])


def test_parameter_files_win_over_the_launch_file_and_the_command_line_over_them(small: Path, tmp_path: Path) -> None:
    first, second = tmp_path / "first.yaml", tmp_path / "second.yaml"
    first.write_text("player: {ros__parameters: {rate: 3.0, start_offset: 1.0}}\narm: {ros__parameters: {model: ur3e}}")
    second.write_text("player: {ros__parameters: {rate: 4.0}}")
    plan = read_launch_file(small, ["log:=a"], ["player.start_offset:=2.0"], [first, second])
    assert plan.sections["player"] == {"log": "a", "rate": 4.0, "start_offset": 2.0, "remap": ["/a:=/twin"]}
    assert plan.sections["arm"] == {"model": "ur3e"}
    second.write_text("plaer: {ros__parameters: {rate: 4.0}}")
    with pytest.raises(TwinError, match=r"second.yaml: parameters: unknown node 'plaer'; did you mean 'player'"):
        read_launch_file(small, ["log:=a"], [], [second])


def test_parameter_files_that_ship_are_found_from_anywhere(
    small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As `replay --params` and the launch file itself are."""
    monkeypatch.chdir(tmp_path)
    plan = read_launch_file(small, ["log:=a"], [], [Path("launch/demo.yaml")])
    assert plan.sections["arm"] == {"model": "ur5e"}


def test_arguments_begin_at_home(small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    assert read_launch_file(small, ["log:=~/a.mcap"]).sections["player"]["log"] == str(tmp_path / "a.mcap")
    given = ["recorder.output:=~/run", "recorder.topics:=[~/a]"]
    sections = read_launch_file(small, ["log:=a.mcap"], given).sections
    assert sections["recorder"] == {"output": str(tmp_path / "run"), "topics": ["~/a"]}


def test_arguments_for_which_nothing_runs_are_told(small: Path) -> None:
    small.write_text("launch: {arguments: {role: {}}, processes: {twin: {nodes: [twin], if: $(var role) == twin}}}")
    with pytest.raises(TwinError, match=r"nothing to run with role:=twinn: .*twin: twinn == twin.*--show-args"):
        read_launch_file(small, ["role:=twinn"])


def test_a_machine_s_role_is_one_of_two() -> None:
    with pytest.raises(TwinError, match="argument role: expected one of cameras, twin, found 'twinn'"):
        read_launch_file("launch/two_machines.yaml", ["role:=twinn"])
    with pytest.raises(TwinError, match=r"needs role:=VALUE \(role: what this machine does \[cameras, twin\]\)"):
        read_launch_file("launch/two_machines.yaml", [])
