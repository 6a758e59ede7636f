"""A search for exploits: short lists of actions, evolved for return alone, whatever earns it."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from envs.scene import Scene
from envs.task import Resection
from envs.vector import ResectVectorEnv

Genes = tuple[int, ...]

MEAN_LENGTH = 12
"""Actions of a random list, on average."""
MUTATIONS = 1.5
"""Changes of a child, on average, beside at least one."""


class Pool(NamedTuple):
    """What actions are drawn from."""

    n_actions: int
    near: np.ndarray
    """Actions round the target: half of all draws, for most of what matters happens there."""

    def draw(self, rng: np.random.Generator) -> int:
        """Return one action."""
        return int(rng.choice(self.near) if rng.random() < 0.5 else rng.integers(self.n_actions))


class Found(NamedTuple):
    """One episode, and what it earned."""

    total_return: float
    """Sum of the rewards."""
    actions: Genes
    """What was done from the first cut to the end of the episode."""
    reason: str
    """Why the episode ended."""
    cost_ratio: float
    """Cost over J*."""
    n_holding: int
    """Faces that still joined the target to healthy tissue."""

    @property
    def rank(self) -> tuple[float, int, float]:
        """Return what lists are sorted by, best first: without a guide from the target, search would never free it once."""
        return -round(self.total_return, 1), self.n_holding, -self.total_return


class Search(NamedTuple):
    """How to search: (mu + lambda), the best of parents and children together live on."""

    n_parents: int
    n_children: int
    n_generations: int


def evolve(scene: Scene, search: Search, seed: int, beginners: Sequence[Genes] = ()) -> list[Found]:
    """Return the best list of each generation, starting from random lists and some given ones."""
    rng = np.random.default_rng(seed)
    task, env = Resection(scene), ResectVectorEnv(search.n_children, scene)
    pool = Pool(env.n_actions, np.flatnonzero(task.action_mask("focus")))
    holding = np.flatnonzero(np.diff(scene.target[task.table.face_tetrahedra], axis=1)[:, 0])
    lists = [*beginners, *(random_genes(rng, pool) for _ in range(search.n_children - len(beginners)))]
    parents: list[Found] = []
    best = []
    for _ in range(search.n_generations):
        # Of lists that do the same, one is enough: the population does not become copies of its best.
        everyone = {each.actions: each for each in [*parents, *play_lists(env, lists, holding)]}
        parents = sorted(everyone.values(), key=lambda each: (each.rank, each.actions))[: search.n_parents]
        best.append(max(parents, key=lambda each: each.total_return))
        lists = [child(rng, [each.actions for each in parents], pool) for _ in range(search.n_children)]
    return best


def play_lists(env: ResectVectorEnv, lists: Sequence[Genes], holding: np.ndarray) -> list[Found]:
    """Play an episode to its end in each row: a list without what is illegal in it, and then the first that is legal, always."""
    observation, _ = env.reset(seed=0)
    waiting = [list(genes) for genes in lists]
    done: list[list[int]] = [[] for _ in lists]
    earned = np.zeros(len(lists))
    found: list[Found | None] = [None] * len(lists)
    while None in found:
        masks = observation["action_mask"]
        # What has ended is given actions that are refused: they take no time, and do not count.
        actions = np.array([
            next_action(mask, waiting[row]) if found[row] is None else mask.argmin() for row, mask in enumerate(masks)
        ])  # fmt: skip
        observation, rewards, terminated, truncated, info = env.step(actions)
        for row in (row for row, known in enumerate(found) if known is None):
            done[row].append(int(actions[row]))
            earned[row] += rewards[row]
            if terminated[row] or truncated[row]:
                n_holding = int(observation["action_mask"][row, holding].sum())
                reason, cost_ratio = info["reason"][row], float(info["cost_ratio"][row])
                found[row] = Found(float(earned[row]), tuple(done[row]), reason, cost_ratio, n_holding)
    return [each for each in found if each is not None]


def next_action(mask: np.ndarray, waiting: list[int]) -> int:
    """Take the next legal action off a list, else the first legal one of all."""
    while waiting:
        action = waiting.pop(0)
        if mask[action]:
            return action
    return int(mask.argmax())


def random_genes(rng: np.random.Generator, pool: Pool) -> Genes:
    """Return a random list."""
    return tuple(pool.draw(rng) for _ in range(1 + rng.poisson(MEAN_LENGTH)))


def child(rng: np.random.Generator, parents: Sequence[Genes], pool: Pool) -> Genes:
    """Return the head of one list before the tail of another, with a few changes."""
    one, other = (parents[i] for i in rng.integers(len(parents), size=2))
    genes = [*one[: rng.integers(len(one) + 1)], *other[rng.integers(len(other) + 1) :]] if rng.random() < 0.5 else list(one)
    for _ in range(1 + rng.poisson(MUTATIONS)):
        change(rng, genes, pool)
    return tuple(genes)


def change(rng: np.random.Generator, genes: list[int], pool: Pool) -> None:
    """Insert, delete, replace or move one action."""
    kind, action = rng.integers(4), pool.draw(rng)
    if kind > 0 and genes:
        taken = genes.pop(int(rng.integers(len(genes))))
        if kind == 1:
            return
        action = taken if kind == 2 else action
    genes.insert(int(rng.integers(len(genes) + 1)), action)


def told(scene: Scene, found: Found) -> str:
    """Say what a list did."""
    table = Resection(scene).table
    faces = [action for action in found.actions if action < table.n_faces]
    removed = np.array([action - table.n_faces for action in found.actions if action >= table.n_faces], dtype=int)
    n_round = int((scene.target[table.face_tetrahedra[faces]].sum(axis=1) == 1).sum())
    return (
        f"seed {scene.seed}: return {found.total_return:.3f}, {found.reason} at {found.cost_ratio:.2f} J*: "
        f"{n_round} faces round the target and {len(faces) - n_round} others cut, "
        f"{scene.target[removed].sum()} of its tetrahedra and {(~scene.target[removed]).sum()} others removed; {found.actions}"
    )
