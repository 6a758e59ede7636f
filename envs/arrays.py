"""What a scene in play is to kernels: the body, how the episode stands, and the rules, in one structure of arrays."""

from typing import Any, NamedTuple

import numpy as np

from envs.action_table import ActionTable, Surroundings, face_pieces, touching_actions
from envs.costs import face_costs, loss_costs, tetrahedron_costs
from envs.scene import Scene
from envs.sight import Sight, no_sight, sight_of
from gmapspring.addresses import struct_reader
from gmapspring.arena import SCRATCH, SHARED, WHOLE, Layout, layout_of
from gmapspring.batch import BODY_EXTENTS, room_for
from gmapspring.body import BodyArrays

Array = np.ndarray[Any, Any]

COST, FACE, TETRAHEDRON, LOSS, HEALTHY_STRAIN, TARGET_STRAIN, LOWEST_RATIO, HEALTHY_VOLUME, TARGET_VOLUME = range(9)
"""Places in Play.numbers: the cost so far, the parts of the last action's cost, and the numbers of `collapse.Tissue`."""
N_COMPONENTS, IS_FINITE, N_STEPS, IS_TOUCHED, LAST_CUT = range(5)
"""Places in Play.whole: pieces, whether all measures are finite, actions so far, whether a vessel has been touched, and the last
cut, negative before the first."""


class Play(NamedTuple):
    """How an episode stands; arrays over tetrahedra unless they say otherwise."""

    is_attached: Array
    """Hangs on an anchor, bool (n,)."""
    label_of: Array
    """Component, in the order of its lowest tetrahedron, -1 where it is gone, int32 (n,)."""
    is_loaded: Array
    """Target that shares the load, bool (n,)."""
    strain: Array
    """Largest edge strain, 0 where not attached, (n,)."""
    volume_ratio: Array
    """Volume over rest volume, 0 where not attached, (n,)."""
    numbers: Array
    """What a policy, a reward or a rule of collapse asks for, (9,)."""
    whole: Array
    """The same in whole numbers, int64 (5,)."""
    mask: Array
    """Legal actions, int8 (n_actions,)."""
    queue: Array
    """Scratch, int32 (n,)."""
    spring_strain: Array
    """Scratch, (6n,)."""
    is_surface_edge: Array
    """Scratch: which springs lie on the surface, bool (6n,)."""
    row_of_node: Array
    """Scratch: the row that shows a node, int32 (4n,)."""
    node_sums: Array
    """Scratch: what is summed over the tetrahedra of a node, (4n, 4)."""


class Rules(NamedTuple):
    """What stays the same while a scene is played."""

    face_slots: Array
    face_of_slot: Array
    volume: Array
    is_target: Array
    """bool (n,)."""
    region_of: Array
    """Face-connected piece of the uncut target, -1 where healthy, int32 (n,)."""
    region_share: Array
    """Share of the load that each piece bears while any of it is attached, (n_regions,)."""
    is_anchor: Array
    is_near: Array
    is_vessel: Array
    """Must not be laid open, bool (n,)."""
    is_touching: Array
    """Actions that lay a vessel open, bool (n_actions,)."""
    centroid: Array
    """Rest centroid of what each action cuts [m], (n_actions, 3)."""
    reach: Array
    """How far from the last cut the next may lie [m], infinite without a tool, (1,)."""
    face_cost: Array
    """Cost of cutting each face, (n_faces,)."""
    tetrahedron_cost: Array
    """Cost of removing each tetrahedron, (n,)."""
    loss_cost: Array
    """Cost of each tetrahedron coming loose, (n,)."""
    load: Array
    """Total force on the target [N], (3,)."""
    start: Array
    """Healthy and target volume of the settled, uncut body [m^3], (2,)."""
    sight: Sight
    """What observations are made with."""


class TaskArrays(NamedTuple):
    """All of it; the body first, so that what reads a body reads a row of these too."""

    body: BodyArrays
    play: Play
    rules: Rules


PLAY_EXTENTS: Any = Play(
    is_attached=WHOLE, label_of=WHOLE, is_loaded=WHOLE, strain=WHOLE, volume_ratio=WHOLE, numbers=WHOLE, whole=WHOLE, mask=WHOLE,
    queue=SCRATCH, spring_strain=SCRATCH, is_surface_edge=SCRATCH, row_of_node=SCRATCH,
    node_sums=SCRATCH,
)  # fmt: skip
RULES_EXTENTS: Any = Rules(*(SHARED,) * len(Rules._fields))._replace(sight=Sight(*(SHARED,) * len(Sight._fields)))
TASK_EXTENTS: Any = TaskArrays(BODY_EXTENTS, PLAY_EXTENTS, RULES_EXTENTS)
"""What each array is to a batch; see gmapspring/arena.py."""


def empty_play(n_tetrahedra: int, n_actions: int) -> Play:
    """Make the arrays of an episode."""
    n = n_tetrahedra
    return Play(
        is_attached=np.zeros(n, bool),
        label_of=np.zeros(n, np.int32),
        is_loaded=np.zeros(n, bool),
        strain=np.zeros(n),
        volume_ratio=np.zeros(n),
        numbers=np.zeros(9),
        whole=np.zeros(5, np.int64),
        mask=np.zeros(n_actions, np.int8),
        queue=np.zeros(n, np.int32),
        spring_strain=np.zeros(6 * n),
        is_surface_edge=np.zeros(6 * n, bool),
        row_of_node=np.zeros(4 * n, np.int32),
        node_sums=np.zeros((4 * n, 4)),
    )


def rules_of(scene: Scene, table: ActionTable, around: Surroundings) -> Rules:
    """Return the rules of a scene; the start is filled in once the body has settled."""
    target, region_of = np.array(scene.target), face_pieces(table, scene.target)
    region_volume = np.bincount(region_of[target], weights=table.volume[target])
    centroid = np.concatenate([table.face_centroid, scene.mesh.points[scene.mesh.tetrahedra].mean(axis=1)])
    radius = np.inf if scene.tool_radius is None else scene.tool_radius
    return Rules(
        face_slots=table.face_slots,
        face_of_slot=table.face_of_slot,
        volume=table.volume,
        is_target=target,
        region_of=region_of,
        region_share=region_volume / region_volume.sum(),
        is_anchor=around.is_anchor,
        is_near=around.is_near,
        is_vessel=np.array(scene.vessel),
        is_touching=touching_actions(table, scene.vessel),
        centroid=centroid,
        # Round-off must not decide on cuts of a regular mesh that lie at this very distance.
        reach=np.array([radius * scene.spacing * (1.0 + 1e-9)]),
        face_cost=face_costs(table.face_area, scene.spacing),
        tetrahedron_cost=tetrahedron_costs(table.volume, scene.spacing),
        loss_cost=loss_costs(table.volume, ~scene.target, scene.spacing),
        load=np.array(scene.load, dtype=np.float64),
        start=np.ones(2),
        sight=sight_of(scene, table),
    )


def no_rules() -> Rules:
    """Return rules of no tetrahedra at all: what the types of their arrays are."""
    no_face, nothing, none = np.zeros((0, 2), np.int32), np.zeros(0), np.zeros(0, bool)
    return Rules(
        face_slots=no_face, face_of_slot=np.zeros((0, 4), np.int32), volume=nothing, is_target=none,
        region_of=np.zeros(0, np.int32), region_share=nothing, is_anchor=none, is_near=none, is_vessel=none, is_touching=none,
        centroid=np.zeros((0, 3)), reach=nothing, face_cost=nothing, tetrahedron_cost=nothing, loss_cost=nothing, load=nothing,
        start=nothing, sight=no_sight(),
    )  # fmt: skip


def task_room(n_tetrahedra: int, n_actions: int, dtype: type, n_work: int) -> TaskArrays:
    """Return arrays with room for any scene on so many tetrahedra."""
    return TaskArrays(room_for(n_tetrahedra, dtype, n_work), empty_play(n_tetrahedra, n_actions), no_rules())


read_task = struct_reader(lambda dtype: task_room(0, 0, dtype, 0))
"""read_task(table, row, real) -> TaskArrays, for kernels; see gmapspring/addresses.py."""


def task_layout(dtype: type) -> Layout:
    """Return what is copied of a row in one precision."""
    return layout_of(task_room(0, 0, dtype, 0), TASK_EXTENTS)


LAYOUTS = {np.float64: task_layout(np.float64), np.float32: task_layout(np.float32)}
"""What is copied of a row, by precision."""
