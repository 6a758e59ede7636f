"""What still hangs on an anchor: the chains of sewn faces."""

from gmapspring.jit import kernel


@kernel
def find_attached(image, component_of, is_anchor, queue, label_of, is_attached):
    """Mark the tetrahedra that a chain of sewn faces joins to an anchor, and label the components.

    Labels are 0, 1 ... in the order of the lowest tetrahedron: they depend on the body, not on the order of its cuts.

    Args:
        image: alpha_3 of the k = 0 dart of each face, itself where free, int32 (n, 4).
        component_of: negative where removed, int32 (n,).
        is_anchor: tetrahedra with a pinned corner, bool (n,).
        queue: scratch, int32 (n,).
        label_of: out, -1 where removed, int32 (n,).
        is_attached: out, bool (n,).

    Returns:
        The number of components, and the number of tetrahedra in those that hang on no anchor.
    """
    label_of[:] = -1
    is_attached[:] = False
    n_labels, n_loose = 0, 0
    for seed in range(image.shape[0]):
        if component_of[seed] < 0 or label_of[seed] >= 0:
            continue
        queue[0], label_of[seed] = seed, n_labels
        n_met, place, hangs = 1, 0, False
        while place < n_met:
            tet = queue[place]
            place += 1
            hangs = hangs or is_anchor[tet]
            for face in range(4):
                other = image[tet, face] // 24
                if label_of[other] < 0:
                    queue[n_met], label_of[other] = other, n_labels
                    n_met += 1
        if hangs:
            is_attached[queue[:n_met]] = True
        else:
            n_loose += n_met
        n_labels += 1
    return n_labels, n_loose
