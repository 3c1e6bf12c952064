"""What the graph forgets: objects that nobody sees any more, and places that are over and hold nothing together."""

from __future__ import annotations

from dataclasses import replace

from multicam.scenegraph.graph import Rest, SceneGraph
from multicam.scenegraph.solution import reached


def prune(graph: SceneGraph, timestamp_ns: int) -> SceneGraph:
    """Ends rests that nobody has confirmed for long, and drops what is over and not needed."""
    config = graph.config.objects

    def is_over(rest: Rest) -> bool:
        patience = config.forget_after if rest.sightings >= config.min_sightings else config.doubt_after
        return rest.over or rest.seen_ns < timestamp_ns - patience * 1e9

    rests = {n: replace(rest, over=is_over(rest)) for n, rest in graph.rests.items()}
    oldest = timestamp_ns - config.forget_after * 1e9
    movers = {i: mover for i, mover in graph.movers.items() if mover.seen_ns >= oldest}
    graph = without_idle_rests(replace(graph, rests=rests, movers=movers))
    for stay in graph.former:
        shorter = replace(graph, former=tuple(other for other in graph.former if other is not stay))
        if is_whole(shorter):
            graph = shorter
    over = sorted((rest.seen_ns, n) for n, rest in graph.rests.items() if rest.over)
    for _, number in over[: max(0, len(over) - config.remember)]:
        shorter = only(graph, set(graph.rests) - {number})
        if is_whole(shorter):
            graph = shorter
    return graph


def without_idle_rests(graph: SceneGraph) -> SceneGraph:
    """The graph without rests that no stay saw, or that are over and tie no two stays."""
    ties = {n: sum(n in stay.edges for stay in graph.stays) for n in graph.rests}
    return only(graph, {n for n, rest in graph.rests.items() if ties[n] > rest.over})


def only(graph: SceneGraph, numbers: set[int]) -> SceneGraph:
    """The graph with some of its rests."""
    if len(numbers) == len(graph.rests):
        return graph
    stays = tuple(
        replace(stay, edges={n: edge for n, edge in stay.edges.items() if n in numbers}) for stay in graph.stays
    )
    return replace(graph.with_stays(stays), rests={n: rest for n, rest in graph.rests.items() if n in numbers})


def is_whole(graph: SceneGraph) -> bool:
    """Whether all stays hang together, and every rest was seen from one of them."""
    seen = set[int]().union(*(stay.edges for stay in graph.stays))
    return len(reached(graph)) == len(graph.stays) and set(graph.rests) <= seen
