"""What still hangs on an anchor: the chains of sewn faces."""

import numpy as np

from gmapspring.jit import part


@part
def find_attached(task):
    """Set Play.is_attached, label_of and the number of components; return how many tetrahedra hang on no anchor.

    Labels are 0, 1 ... in the order of the lowest tetrahedron: they depend on the body, not on the order of its cuts.
    """
    image, component_of, is_anchor = task.body.gmap.image, task.body.gmap.component_of, task.rules.is_anchor
    play = task.play
    queue, label_of, is_attached = play.queue, play.label_of, play.is_attached
    n_tets = len(label_of)
    for tet in range(n_tets):
        label_of[tet] = -1
        is_attached[tet] = False
    n_labels, n_loose = 0, 0
    for seed in range(n_tets):
        if component_of[seed] < 0 or label_of[seed] >= 0:
            continue
        queue[0], label_of[seed] = seed, n_labels
        n_met, place, hangs = 1, 0, False
        while place < n_met:
            tet = np.uint64(queue[place])
            place += 1
            hangs = hangs or is_anchor[tet]
            for face in range(4):
                other = np.uint64(image[tet, face]) // np.uint64(24)
                if label_of[other] < 0:
                    queue[n_met], label_of[other] = other, n_labels
                    n_met += 1
        if hangs:
            for place in range(n_met):
                is_attached[np.uint64(queue[place])] = True
        else:
            n_loose += n_met
        n_labels += 1
    play.whole[0] = n_labels
    return n_loose
