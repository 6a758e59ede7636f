"""What an action does before time passes: cut, take off what hangs on nothing, count the cost, share the load anew."""

import numpy as np

from envs.actions import is_sewn
from envs.arrays import COST, FACE, IS_TOUCHED, LAST_CUT, LOSS, TETRAHEDRON, read_task
from envs.attachment import find_attached
from gmapspring.cut import cut_part
from gmapspring.embedding import sum_nodes
from gmapspring.jit import kernel, part

BEGIN = np.int64(-1)
"""The action that cuts nothing and begins an episode: at no cost, with the load spread."""


@kernel
def act(table, rows, real, actions, is_done):
    """Carry out an action in each of some rows; is_done: out, False where it is illegal and nothing has changed, bool (k,)."""
    for k in range(len(rows)):
        task = read_task(table, rows[k], real)
        is_done[k] = actions[k] == BEGIN or is_legal(task, actions[k])
        if is_done[k]:
            carry_out(task, actions[k])


@part
def is_legal(task, action):
    """Tell whether there is something to cut: a sewn face or a tetrahedron that are attached, and no anchor to be removed."""
    is_attached, face_slots = task.play.is_attached, task.rules.face_slots
    n_faces = len(face_slots)
    if action < 0 or action >= n_faces + len(is_attached):
        return False
    if action < n_faces:
        return is_sewn(task.body.gmap.image, is_attached, face_slots[action, 0])
    return is_attached[action - n_faces] and not task.rules.is_anchor[action - n_faces]


@part
def carry_out(task, action):
    """Do a legal action; the parts of its cost go to Play.numbers."""
    numbers, whole, rules = task.play.numbers, task.play.whole, task.rules
    n_faces = len(rules.face_slots)
    whole[LAST_CUT] = action
    numbers[FACE], numbers[TETRAHEDRON] = 0.0, 0.0
    is_face = 0 <= action < n_faces
    slots, removed = np.empty(1 if is_face else 0, dtype=np.int64), np.empty(1 if action >= n_faces else 0, dtype=np.int64)
    if is_face:
        slots[0], numbers[FACE] = rules.face_slots[action, 0], rules.face_cost[action]
    elif action != BEGIN:
        removed[0], numbers[TETRAHEDRON] = action - n_faces, rules.tetrahedron_cost[action - n_faces]
    else:
        numbers[COST], whole[IS_TOUCHED] = 0.0, 0
        forget_load(task)
    if action != BEGIN and rules.is_touching[action]:
        whole[IS_TOUCHED] = 1
    numbers[LOSS] = cut_loose(task, slots, removed)
    spread_load(task)
    numbers[COST] += numbers[FACE] + numbers[TETRAHEDRON] + numbers[LOSS]


@part
def cut_loose(task, slots, removed):
    """Cut faces and remove tetrahedra, then take off what hangs on no anchor any more; return what healthy tissue that costs."""
    cost = 0.0
    while True:  # one call of the cut, since its code is large: first for the action, then for what has come loose
        has_come_apart = len(slots) == 0
        if len(slots) + len(removed) > 0:
            change = cut_part(task.body, slots, removed)
            has_come_apart = len(removed) > 0 or len(change.labels) > 0
        n_loose = find_attached(task) if has_come_apart else 0
        if n_loose == 0:
            return cost
        slots, removed = slots[:0], np.empty(n_loose, dtype=np.int64)
        cost += list_loose(task, removed)


@part
def list_loose(task, loose):
    """List the pieces that hang on no anchor, ascending; return the cost of the healthy tissue among them."""
    label_of, is_attached, loss_cost = task.play.label_of, task.play.is_attached, task.rules.loss_cost
    whole, is_vessel = task.play.whole, task.rules.is_vessel
    n_found, cost = 0, 0.0
    for tet in range(len(label_of)):
        if label_of[tet] >= 0 and not is_attached[tet]:
            loose[n_found] = tet
            n_found += 1
            cost += loss_cost[tet]
            if is_vessel[tet]:
                whole[IS_TOUCHED] = 1
    return cost


@part
def forget_load(task):
    """Let the next sharing of the load take place whatever bears it now."""
    is_loaded = task.play.is_loaded
    for tet in range(len(is_loaded)):
        is_loaded[tet] = False


@part
def spread_load(task):
    """Share the force on each region among what is attached of it by volume: shaving the target sheds no load."""
    is_loaded, is_attached = task.play.is_loaded, task.play.is_attached
    is_target, volume, force = task.rules.is_target, task.rules.volume, task.rules.load
    region_of, region_share = task.rules.region_of, task.rules.region_share
    load = task.body.matter.tetrahedra.load
    total, has_changed = np.zeros(len(region_share)), False
    for tet in range(len(is_loaded)):
        bears = is_target[tet] and is_attached[tet]
        has_changed = has_changed or bears != is_loaded[tet]
        is_loaded[tet] = bears
        if bears:
            total[region_of[tet]] += volume[tet]
    if has_changed:
        for tet in range(len(is_loaded)):
            share, region = 0.0, region_of[tet]
            if is_loaded[tet]:
                share = region_share[region] * (0.25 * (volume[tet] / total[region]))
            for corner in range(4):
                for axis in range(3):
                    load[tet, corner, axis] = share * force[axis]
        sum_nodes(task.body.gmap, task.body.matter)
