"""Arguments, messages and exit codes of `python -m agents`.

Exit codes: 0 done; 1 an error, told in one line; 2 wrong arguments; 130 interrupted, with what was learnt kept.
"""

import argparse
import os
import pathlib
import sys
from collections.abc import Sequence

from rich.console import Console

from agents.choice import home_of, make_policy, require_torch
from agents.evaluation import Policy, episodes_as_csv, evaluate, summarise
from agents.progress import ProgressReport
from agents.scripted import POLICIES
from agents.table import HEADERS, print_table, summary_rows
from envs.resect import ResectEnv
from gmapspring.config import load_config
from gmapspring.errors import ConfigError, GmapspringError
from gmapspring.paths import config_file, write_atomically

EXAMPLES = """examples:
  python -m agents train box-108 --seed 1 --out runs/box-108
  python -m agents train box-108 --out runs/box-108 --resume --cpu-seconds 400
  python -m agents evaluate runs/box-108/best.zip --out runs/box-108/test.csv
  python -m agents evaluate lookahead --scene box-108 --split test --episodes 16
  python -m agents evaluate shield:rim-first search:100 --scene box-108
  python -m agents demo --out runs/demo
  python -m agents study results --jobs 2 --only level-1 --seeds 0,1
  python -m agents report runs/results
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return the exit code."""
    parsed = _parser().parse_args(arguments)
    try:
        code: int = parsed.run(parsed, Console())
        return code
    except (GmapspringError, OSError) as error:
        if parsed.debug:
            raise
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130


def _parser() -> argparse.ArgumentParser:
    """Return the parser of all commands."""
    parser = argparse.ArgumentParser(
        prog="python -m agents",
        description="Train cutting policies and compare them.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    _add_train(commands)
    _add_evaluate(commands)
    _add_demo(commands)
    _add_study(commands)
    _add_report(commands)
    return parser


def _add_train(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    command = _command(commands, "train", "train a policy by PPO", "python -m agents train box-108 --seed 1")
    command.add_argument("config", help="a training configuration: a file, or the name of a shipped one")
    command.add_argument("--seed", type=_count, help="replaces the configuration's seed")
    command.add_argument("--cpu-seconds", type=float, help="replaces the configuration's CPU time")
    command.add_argument("--start-from", type=pathlib.Path, metavar="ZIP", help="begin with the weights of a saved policy")
    command.add_argument("--warm-start", choices=("bc", "none"), help="clone the certificates before, or do not [as configured]")
    command.add_argument("--out", type=pathlib.Path, help="run folder [runs/CONFIG-seed-SEED]")
    command.add_argument("--resume", action="store_true", help="go on with the run in the folder")
    command.set_defaults(run=_train)


def _add_evaluate(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    example = "python -m agents evaluate certificate --split test"
    command = _command(commands, "evaluate", "play held-out scenes and print a table", example)
    names = f"a saved policy (*.zip), {', '.join(POLICIES)}, search:BUDGET (simulator steps), or shield: and any of these"
    command.add_argument("policies", nargs="+", metavar="POLICY", help=names)
    command.add_argument("--scene", help="a shipped scene or a scene file [the policy's own, or box-108]")
    command.add_argument("--split", default="test", help="train, validation or test [test]")
    command.add_argument("--mask", help="all, reachable or focus [the policy's own, or all]")
    command.add_argument("--episodes", type=_positive, help="how many [each scene once]")
    command.add_argument("--seed", type=_count, default=0, help="of what is random [0]")
    command.add_argument("--out", type=pathlib.Path, help="write a line per episode to this CSV file")
    command.set_defaults(run=_evaluate)


def _add_demo(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    command = _command(commands, "demo", "cut a liver, train, compare", "python -m agents demo --train-seconds 60")
    command.add_argument("--out", type=pathlib.Path, default=pathlib.Path("runs/demo"), help="folder [runs/demo]")
    command.add_argument("--train-seconds", type=float, default=180.0, help="CPU time of training [180]")
    command.add_argument("--seed", type=_count, default=0, help="of training [0]")
    command.set_defaults(run=_demo)


def _add_study(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    description = "train and evaluate all that a study lists; what is done is kept, what was stopped goes on"
    command = _command(commands, "study", description, "python -m agents study results --only level-1 --seeds 0,1")
    command.add_argument("study", help="a study: a file, or the name of a shipped one")
    command.add_argument("--out", type=pathlib.Path, help="folder [runs/NAME]")
    command.add_argument("--jobs", type=_count, default=os.cpu_count() or 1, help="processes at once [as many as cores]")
    command.add_argument("--only", nargs="+", default=[], metavar="ROW", help="rows, and what they start from; or 'scripts'")
    command.add_argument("--seeds", type=_counts, default=[], help="only these, as in 0,1 [all]")
    command.set_defaults(run=_study)


def _add_report(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    command = _command(commands, "report", "write the page of a study", "python -m agents report runs/results")
    command.add_argument("folder", type=pathlib.Path, help="the study's folder")
    command.add_argument("--publish", action="store_true", help="write the page and its pictures to docs/ as well")
    command.set_defaults(run=_report)


def _command(
    commands: "argparse._SubParsersAction[argparse.ArgumentParser]", name: str, description: str, example: str
) -> argparse.ArgumentParser:
    """Return the parser of a new command."""
    command: argparse.ArgumentParser = commands.add_parser(
        name, help=description, description=description, epilog=f"example: {example}"
    )
    command.add_argument("--debug", action="store_true", default=argparse.SUPPRESS, help="show the traceback of an error")
    return command


def _count(text: str) -> int:
    """Return a whole number from 0 up."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 0 up")
    return int(text)


def _positive(text: str) -> int:
    """Return a whole number from 1 up."""
    if not _count(text):
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1 up")
    return int(text)


def _counts(text: str) -> list[int]:
    """Return whole numbers from 0 up, parted by commas."""
    return [_count(part) for part in text.split(",")]


def _train(parsed: argparse.Namespace, console: Console) -> int:
    """Train, and say where the result lies."""
    require_torch()
    from agents.training import Trainer
    from agents.training_config import TrainingConfig

    path = config_file("train", parsed.config)
    config = load_config(path, TrainingConfig).replaced(parsed.seed, parsed.cpu_seconds, parsed.warm_start)
    out = parsed.out or pathlib.Path("runs") / f"{path.stem}-seed-{config.seed}"
    trainer = Trainer(config, out, start=parsed.start_from, resume=parsed.resume)
    with ProgressReport(console, f"training {path.stem}") as report:
        result = trainer.run(report)
    if result.signal is not None:
        print(
            f"interrupted at step {result.n_steps}: what was learnt is in {out}; go on with --resume",
            file=sys.stderr,
        )
        return 128 + result.signal
    console.print(
        f"{result.n_steps} steps in {result.cpu_seconds:.0f} CPU seconds; best validation return "
        f"{result.best_return:.3f}; the policy is {out / 'best.zip'}",
        highlight=False,
        soft_wrap=True,
    )
    return 0


def _player(name: str, parsed: argparse.Namespace) -> tuple[Policy, ResectEnv]:
    """Return a policy and the environment that it is to play."""
    home = home_of(name)
    env = ResectEnv(parsed.scene or home.scene, parsed.split, parsed.mask or home.mask)
    return make_policy(name, env, parsed.seed), env


def _evaluate(parsed: argparse.Namespace, console: Console) -> int:
    """Play policies on the same scenes, print their table, and write their episodes."""
    if parsed.out and parsed.out.is_dir():
        raise ConfigError(f"--out {parsed.out} is a folder; give the name of a file")
    # All are made before the first plays: what is wrong with the last is then known at once.
    players = [_player(name, parsed) for name in parsed.policies]
    episodes, summaries = [], []
    with ProgressReport(console, "evaluating") as report:
        for name, (policy, env) in zip(parsed.policies, players, strict=True):
            played = evaluate(policy, env, parsed.episodes, name=name, seed=parsed.seed)
            episodes += played
            summaries.append(summarise(played))
            report.update(len(summaries) / len(players), name)
    if parsed.out:
        parsed.out.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(parsed.out, episodes_as_csv(episodes).encode())
    print_table(console, f"{parsed.split} scenes", HEADERS, summary_rows(summaries))
    return 0


def _demo(parsed: argparse.Namespace, console: Console) -> int:
    """Show the whole system at work."""
    require_torch()
    from agents.demo import run_demo

    return run_demo(parsed.out, parsed.train_seconds, parsed.seed, console)


def _study(parsed: argparse.Namespace, console: Console) -> int:
    """Do what a study lists."""
    require_torch()
    from agents.study import Choice, run_study
    from agents.study_config import load_study

    study = load_study(parsed.study)
    out = parsed.out or pathlib.Path("runs") / study.name
    code = run_study(study, out, Choice(parsed.only, parsed.seeds), max(parsed.jobs, 1), console)
    console.print(f"everything is in {out}; python -m agents report {out} writes the page", highlight=False, soft_wrap=True)
    return code


def _report(parsed: argparse.Namespace, console: Console) -> int:
    """Write the page of a study."""
    from agents.report import DOCS, write_report

    if parsed.publish and not DOCS.is_dir():
        raise ConfigError(f"there is no {DOCS} to publish to; publish from a clone")
    path = write_report(parsed.folder, DOCS if parsed.publish else None)
    console.print(f"the page is {path}", highlight=False, soft_wrap=True)
    return 0
