"""Prove that scenes can be solved, and set their loads: `python -m envs.certify box-108 --jobs 2`, or `my.yaml --seed 3` for one.

For every seed: the cheapest cuts (optimum.py), the order of them that strains healthy tissue least (order.py), and the
load at which that order strains it to kappa times the limit. What comes out is proven by carrying it out from the start in
the very task that an agent plays, and under longer settling, other schemes and single precision besides. A seed without such
a proof is rejected, and the reason is kept and counted.
"""

import argparse
import os
import signal
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from multiprocessing import get_context

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from envs import library
from envs.action_table import action_table
from envs.calibrate import LOAD_TOLERANCE, Rejected, calibrated, is_calibrated, proven_plan
from envs.finding import describe
from envs.library import CertificateFile, Record
from envs.optimum import minimum_cut
from envs.order import Replay, replay
from envs.scene import Certificate, NoSceneError, Scene, build_scene
from envs.scene_config import SceneConfig
from envs.task import Resection
from gmapspring.errors import GmapspringError

LOAD_NUDGE = 1e-3
"""Relative change of the load that must not matter."""
LONGER_SETTLES = (2.0, 4.0)
"""How many times longer a body must be able to settle after each cut."""
OTHER_SCHEMES = ("rk4", "velocity_verlet")
"""Schemes that must end alike."""
TRAJECTORY_LENGTH = 5
"""Strains kept of the first certificate."""
SAVE_EVERY = 16
"""Seeds after which the file is written."""


def certify(config: SceneConfig, seed: int) -> Certificate:
    """Return the certificate of a seed, or raise `Rejected` with the reason."""
    task, wanted = Resection(build_scene(config, seed)), config.kappa * config.limits.strain
    cut = minimum_cut(task.scene, task.table)
    order, factor = calibrated(task, wanted, proven_plan(cut))
    # The proof proper: a scene built anew with this certificate, played from the start.
    certificate = Certificate(cut.cost, order, factor, 0.0, 0.0)
    task = Resection(build_scene(config, seed, certificate))
    proof = replay(task, order)
    if not proof.survives:
        raise Rejected("no order survives")
    if abs(proof.cost / cut.cost - 1.0) > 1e-9:
        raise Rejected("plan costs more than the optimum")
    if not is_calibrated(wanted, proof) or not _is_steady(task, order, proof):
        raise Rejected("a slightly different load ends differently")
    if not ends_alike(config, seed, certificate):
        raise Rejected("other physics end differently")
    return Certificate(cut.cost, order, factor, proof.peak_strain, proof.lowest_volume_ratio)


def ends_alike(config: SceneConfig, seed: int, certificate: Certificate) -> bool:
    """Return whether the body survives longer settling, other schemes and single precision too.

    A tetrahedron about to snap inside out shows little strain before: no margin of strain or volume tells, only the play does.
    """
    changes: list[dict[str, object]] = [{"dtype": "float32"}]
    changes += [{"settle_seconds": factor * config.physics.settle_seconds} for factor in LONGER_SETTLES]
    changes += [{"integrator": name} for name in OTHER_SCHEMES]
    for change in changes:
        changed = config.model_copy(update={"physics": config.physics.model_copy(update=change)})
        if not replay(Resection(build_scene(changed, seed, certificate)), certificate.order).survives:
            return False
    return True


def _is_steady(task: Resection, order: Sequence[int], proof: Replay) -> bool:
    """Return whether slightly different loads end alike: no body is balanced so that round-off decides."""
    load = task.scene.load
    for factor in (1.0 - LOAD_NUDGE, 1.0 + LOAD_NUDGE):
        task.set_load(load * factor)
        nudged = replay(task, order)
        if not nudged.survives or abs(nudged.peak_strain / proof.peak_strain - 1.0) > LOAD_TOLERANCE:
            return False
    return True


def physics_trajectory(config: SceneConfig, records: Sequence[Record]) -> list[float]:
    """Return the healthy strains along the first certificate: they change if the physics does."""
    first = next((record for record in records if record.certificate), None)
    if first is None or first.certificate is None:
        return []
    task = Resection(build_scene(config, first.seed, first.certificate))
    strains = [task.tissue.healthy_strain]
    for action in first.certificate.order[: TRAJECTORY_LENGTH - 1]:
        task.step(action)
        strains.append(task.tissue.healthy_strain)
    return [round(strain, 9) for strain in strains]


# Many seeds -------------------------------------------------------------------------------------------------------


def examine(config: SceneConfig, split: str, seed: int) -> Record:
    """Return what certification finds for a seed of a split."""
    try:
        certificate = certify(config, seed)
        if removes_target(build_scene(config, seed), certificate):
            raise Rejected("nothing is cheaper than to remove all of the target")
        return Record(split, seed, certificate, "")
    except Rejected as rejection:
        return Record(split, seed, None, str(rejection))
    except NoSceneError:
        return Record(split, seed, None, "the target is all anchor")


def removes_target(scene: Scene, certificate: Certificate) -> bool:
    """Return whether the plan is to remove all of the target, which would teach nothing of cuts."""
    tetrahedra = np.array(certificate.plan) - action_table(scene.mesh).n_faces
    return bool(np.isin(np.flatnonzero(scene.target), tetrahedra).all())


def report_seed(scene: str, seed: int, console: Console) -> None:
    """Print what certification finds for one seed, in full; nothing is written to any file."""
    config = library.load_scene_config(scene)
    try:
        record = Record("", seed, certify(config, seed), "")
    except Rejected as rejection:
        record = Record("", seed, None, str(rejection))
    for line in describe(config, record):
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    if record.certificate and removes_target(build_scene(config, seed), record.certificate):
        console.print("a level leaves such a seed out: nothing is cheaper than to remove all of the target", highlight=False)


def wanted_seeds(config: SceneConfig, records: dict[tuple[str, int], Record]) -> Iterator[tuple[str, int]]:
    """Yield seeds to examine until every split has its scenes; `records` grows meanwhile, and nothing is done twice."""
    for split, rule in config.splits.items():
        for seed in range(*rule.seeds):
            if n_done(config, records, split) == rule.count:
                break
            if (split, seed) not in records:
                yield split, seed


def n_done(config: SceneConfig, records: dict[tuple[str, int], Record], split: str) -> int:
    """Return how many of the scenes wanted of a split there are."""
    return min(len(certified(records, split)), config.splits[split].count)


def certified(records: dict[tuple[str, int], Record], split: str) -> list[int]:
    """Return the seeds of a split that have a certificate, ascending."""
    return sorted(seed for (name, seed), record in records.items() if name == split and record.certificate)


def chosen(config: SceneConfig, records: dict[tuple[str, int], Record]) -> list[Record]:
    """Return the records up to the last scene wanted of each split: the same, however many processes found them."""
    kept = []
    for split, rule in config.splits.items():
        seeds = certified(records, split)
        last = seeds[rule.count - 1] if len(seeds) >= rule.count else rule.seeds[1]
        kept += [records[key] for key in sorted(records) if key[0] == split and key[1] <= last]
    return kept


def examine_all(config: SceneConfig, records: dict[tuple[str, int], Record], n_jobs: int) -> Iterator[Record]:
    """Examine seeds until every split has its scenes, yield what is found, and put it into `records`."""
    seeds = wanted_seeds(config, records)
    if n_jobs == 1:
        for split, seed in seeds:
            records[split, seed] = examine(config, split, seed)
            yield records[split, seed]
        return
    pool = ProcessPoolExecutor(n_jobs, mp_context=get_context("spawn"), initializer=_leave_interrupts_to_the_parent)
    try:
        running: set[Future[Record]] = set()
        while True:
            # Never far ahead, so that little is examined in vain once a split is complete.
            while len(running) < n_jobs and (key := next(seeds, None)):
                running.add(pool.submit(examine, config, *key))
            if not running:
                return
            done, running = wait(running, return_when=FIRST_COMPLETED)
            for record in (future.result() for future in done):
                records[record.split, record.seed] = record
                yield record
    finally:
        pool.shutdown(cancel_futures=True)


def _leave_interrupts_to_the_parent() -> None:
    """Let the parent alone hear Ctrl-C, so that workers end in good order."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def load_records(scene: str, config: SceneConfig, restart: bool) -> dict[tuple[str, int], Record]:
    """Return what an earlier run found, or raise where it was made for another configuration or other physics."""
    path = library.certificate_path(scene)
    if restart or not path.exists():
        return {}
    file = library.read_certificates(path)
    trajectory = physics_trajectory(config, file.records)
    same = len(trajectory) == len(file.trajectory) and all(
        abs(now - then) <= 1e-6 for now, then in zip(trajectory, file.trajectory, strict=True)
    )
    if file.digest != library.scene_digest(config) or not same:
        raise GmapspringError(f"{path} was made for another configuration or other physics; add --restart to replace it")
    return {(record.split, record.seed): record for record in file.records}


def save_records(scene: str, config: SceneConfig, records: dict[tuple[str, int], Record]) -> None:
    """Write what has been found so far."""
    kept = chosen(config, records)
    file = CertificateFile(library.scene_digest(config), physics_trajectory(config, kept), kept)
    library.write_certificates(library.certificate_path(scene), file)


def run(scene: str, n_jobs: int, restart: bool, console: Console) -> bool:
    """Certify all splits of a scene; return whether it was finished rather than interrupted."""
    config = library.load_scene_config(scene)
    records = load_records(scene, config, restart)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    finished = False
    try:
        with Progress(*columns, TimeRemainingColumn(), console=console) as progress:
            bars = {split: progress.add_task(f"{config.name} {split}", total=rule.count) for split, rule in config.splits.items()}
            for split in bars:
                progress.update(bars[split], completed=n_done(config, records, split))
            for count, record in enumerate(examine_all(config, records, n_jobs), start=1):
                progress.update(bars[record.split], completed=n_done(config, records, record.split))
                if count % SAVE_EVERY == 0:
                    save_records(scene, config, records)
        finished = True
    except KeyboardInterrupt:
        console.print("Interrupted: what is done is kept; run the same command to go on.")
    finally:
        # A restart that found nothing yet leaves the old file as it is.
        if records:
            save_records(scene, config, records)
    report(scene, config, chosen(config, records), console)
    return finished


def report(scene: str, config: SceneConfig, records: Sequence[Record], console: Console) -> None:
    """Print how many seeds were certified, and how many were rejected for what."""
    for split, rule in config.splits.items():
        reasons = Counter(record.reason for record in records if record.split == split and not record.certificate)
        n_certified = sum(record.split == split and record.certificate is not None for record in records)
        rejected = ", ".join(f"{count} x {reason}" for reason, count in sorted(reasons.items())) or "none"
        console.print(f"{config.name} {split}: {n_certified} of {rule.count} certified; rejected: {rejected}")
    console.print(f"wrote {library.certificate_path(scene)}")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command line."""
    parser.add_argument("scene", help="name of a shipped scene, or path of a scene file")
    parser.add_argument("--jobs", type=_at_least(1), default=os.cpu_count() or 1, help="processes [one per core]")
    parser.add_argument("--restart", action="store_true", help="forget what an earlier run found")
    parser.add_argument("--seed", type=_at_least(0), help="examine this one seed alone, print what is found, and write nothing")


def _at_least(least: int) -> Callable[[str], int]:
    """Return the kind of an argument that is a whole number, none below the least."""

    def parse(text: str) -> int:
        if not text.isdecimal() or int(text) < least:
            raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from {least} up")
        return int(text)

    return parse


def carry_out(options: argparse.Namespace, console: Console) -> int:
    """Do what the arguments ask for and return the exit status."""
    if options.seed is None:
        return 0 if run(options.scene, options.jobs, options.restart, console) else 130
    report_seed(options.scene, options.seed, console)
    return 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    parser = argparse.ArgumentParser(prog="python -m envs.certify", description=__doc__.split("\n\n")[0])
    add_arguments(parser)
    try:
        return carry_out(parser.parse_args(arguments), Console())
    except GmapspringError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
