"""What can be read off a session, in words: how it stands, cost and energy."""

import numpy as np

from agents.session import Session
from envs.collapse import SEPARATED
from gmapspring.measure import elastic_energy, kinetic_energy, momentum

GOING_ON, FREED, LOST = "#5b6b7a", "#2b8a3e", "#c92a2a"
"""Colours of how an episode stands."""


def title_of(session: Session) -> str:
    """Return what is played."""
    scene = session.scene
    return f"{scene.name}, {session.split} seed {scene.seed} ({session.index + 1} of {len(session.env.scenes)} scenes)"


def status_of(session: Session, message: str) -> tuple[str, str]:
    """Return how things stand, with what there is to say besides, and a colour for it."""
    moment = session.moment
    if not moment.is_over:
        return message or "Free the target: cut it off, and let no healthy tissue tear.", GOING_ON
    if moment.reason == SEPARATED:
        return f"The target is free: return {moment.total_return:.3f} of at most 1. {message}", FREED
    words = {"tear": "healthy tissue tears", "budget": "the budget is spent"}
    return f"Lost: {words.get(str(moment.reason), str(moment.reason))}. {message}", LOST


def readings(session: Session) -> dict[str, str]:
    """Return the read-outs by name; energies are those of the body that is shown, which may still move."""
    task, body, moment = session.task, session.task.simulation.body, session.moment
    optimum = session.env.optimum
    rows = {
        "cuts": str(len(moment.actions)),
        "cost": f"{task.cost:.3f}, {task.cost / optimum:.2f} J*",
        "J*": f"{optimum:.3f}, spent at {task.scene.budget * optimum:.3f}",
        "return": f"{moment.total_return:.3f}",
        "reason": moment.reason or "-",
        "tetrahedra": str(int(task.is_attached.sum())),
        "healthy": f"{task.healthy_share:.1%} left, strain {task.tissue.healthy_strain:.3f}",
        "elastic": f"{1e6 * elastic_energy(body):.2f} µJ",
        "kinetic": f"{1e6 * kinetic_energy(body):.4f} µJ",
        "momentum": f"{1e6 * float(np.linalg.norm(momentum(body))):.3f} mg m/s",
    }
    if session.motion.is_shown:
        left = f"{1e3 * session.motion.left:.0f} ms to rest" if session.motion.is_moving else "aside from the episode"
        rows["motion"] = left
    return rows
