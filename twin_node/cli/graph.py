"""`twin_node param` and `twin_node lifecycle`: ask the nodes of a live graph, and lead them."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any


def add_param(commands: Any) -> None:
    """Adds `param` to the subcommands."""
    param = commands.add_parser(
        "param",
        help="say which parameters the nodes of a live graph have",
        description="Ask the nodes of the live graph, those of other programs too, for their parameters. Ours take "
        "them when they are made: set them in the launch file, or with -p.",
    )
    kinds = param.add_subparsers(metavar="COMMAND", required=True)
    listed = kinds.add_parser("list", help="their names")
    _add_node(listed, is_optional=True)
    listed.set_defaults(run=_list)
    got = kinds.add_parser("get", help="the value of one")
    _add_node(got)
    got.add_argument("name", metavar="NAME", help="such as grid.voxel_size")
    got.set_defaults(run=_get)
    described = kinds.add_parser("describe", help="type, value and meaning, of all or of some")
    _add_node(described)
    described.add_argument("names", nargs="*", metavar="NAME")
    described.set_defaults(run=_describe)
    dumped = kinds.add_parser("dump", help="all of them as a parameter file, for --params-file")
    _add_node(dumped)
    dumped.add_argument("-o", "--output", type=Path, metavar="FILE", help="write there (default: print)")
    dumped.set_defaults(run=_dump)


def add_lifecycle(commands: Any) -> None:
    """Adds `lifecycle` to the subcommands."""
    lifecycle = commands.add_parser(
        "lifecycle",
        help="say in which state the nodes of a live graph are, and change it",
        description="Ask the nodes of the live graph for the state that they are in, and lead them to another. A node "
        "that is activated again begins anew. Whoever drives the arm stops it when it is deactivated, and when "
        "nothing says any more that the way is free.",
    )
    kinds = lifecycle.add_subparsers(metavar="COMMAND", required=True)
    got = kinds.add_parser("get", help="the state of a node, or of all")
    _add_node(got, is_optional=True)
    got.set_defaults(run=_state)
    listed = kinds.add_parser("list", help="which transitions a node may go through now")
    _add_node(listed)
    listed.set_defaults(run=_transitions)
    changed = kinds.add_parser("set", help="lead a node through a transition")
    _add_node(changed)
    changed.add_argument("transition", metavar="TRANSITION", help="configure, activate, deactivate, cleanup, shutdown")
    changed.set_defaults(run=_change)


def _add_node(parser: argparse.ArgumentParser, is_optional: bool = False) -> None:
    """Adds the node that a command is about; without one, where it may be left out, it is about all."""
    name = "such as twin"
    if is_optional:
        parser.add_argument("node", nargs="?", metavar="NODE", help=f"{name}; without it all nodes")
    else:
        parser.add_argument("node", metavar="NODE", help=name)


def _list(options: argparse.Namespace) -> None:
    from twin_node.nodes.live.asking import Asking

    with Asking() as graph:
        if options.node is not None:
            print("\n".join(graph.parameters(graph.node(options.node))))
            return
        for node, names in graph.all_parameters().items():
            print("\n  ".join([f"{node}:", *names]))


def _get(options: argparse.Namespace) -> None:
    from twin_node.nodes.live.asking import Asking

    with Asking() as graph:
        value = graph.values(graph.node(options.node), [options.name])[options.name]
    print("not set" if value is None else _in_yaml(value))


def _describe(options: argparse.Namespace) -> None:
    from twin_node.nodes.live.asking import Asking

    with Asking() as graph:
        node = graph.node(options.node)
        described = graph.described(node, options.names or graph.parameters(node))
    for one in described:
        print(f"{one.name}: {one.kind}, {'not set' if one.value is None else _in_yaml(one.value)}")
        if one.description:
            print(f"  {one.description}")


def _dump(options: argparse.Namespace) -> None:
    from twin_node.nodes.live.asking import Asking, as_file
    from twin_node.nodes.topics import GraphError
    from twin_node.yaml_file import write_yaml, yaml_text

    with Asking() as graph:
        node = graph.node(options.node)
        content = as_file(node, graph.values(node, graph.parameters(node)))
    if options.output is None:
        print(yaml_text(content), end="")
    else:
        write_yaml(options.output, content, GraphError)


def _state(options: argparse.Namespace) -> None:
    from twin_node.nodes.live.asking import Asking

    with Asking() as graph:
        if options.node is not None:
            print(graph.state(graph.node(options.node)))
            return
        for node, state in graph.states().items():
            print(f"{node}: {state}")


def _transitions(options: argparse.Namespace) -> None:
    from twin_node.nodes.live.asking import Asking

    with Asking() as graph:
        for label, number in graph.transitions(graph.node(options.node)).items():
            print(f"{label} ({number})")


def _change(options: argparse.Namespace) -> None:
    from twin_node.nodes.live.asking import Asking

    with Asking() as graph:
        node = graph.node(options.node)
        print(f"{node}: {graph.change(node, options.transition)}")


def _in_yaml(value: Any) -> str:
    from twin_node.yaml_file import yaml_text

    return value if isinstance(value, str) else yaml_text(value).removesuffix("...\n").strip()
