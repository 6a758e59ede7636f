"""`gmapspring evaluate`: play held-out scenes and compare."""

import argparse
import pathlib

from rich.console import Console

from agents.choice import home_of, make_policy
from agents.commands.command import Command, add_json, count, positive, print_json, say
from agents.evaluation import Episode, Estimate, Policy, Summary, episodes_as_csv, evaluate, summarise
from agents.progress import ProgressReport
from agents.scripted import POLICIES
from agents.table import HEADERS, print_table, summary_rows
from agents.video import Player, check_video, record_video
from envs.resect import ResectEnv
from gmapspring.errors import ConfigError
from gmapspring.paths import write_atomically


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    names = (
        f"a saved policy (*.zip), {', '.join(POLICIES)}, search:BUDGET (simulator steps), or shield: or foresight:BUDGET: "
        "and any of these"
    )
    parser.add_argument("policies", nargs="+", metavar="POLICY", help=names)
    parser.add_argument("--scene", help="a shipped scene or a scene file [the policy's own, or box-108]")
    parser.add_argument("--split", default="test", help="train, validation or test [test]")
    parser.add_argument("--mask", help="all, reachable or focus [the policy's own, or all]")
    parser.add_argument("--episodes", type=positive, help="how many [each scene once]")
    parser.add_argument("--seed", type=count, default=0, help="of what is random [0]")
    parser.add_argument("--out", type=pathlib.Path, help="write a line per episode to this CSV file")
    parser.add_argument("--video", type=pathlib.Path, help="film the first scenes, policies side by side: .gif, .webp or .mp4")
    parser.add_argument("--video-episodes", type=positive, default=1, metavar="N", help="how many scenes to film [1]")
    add_json(parser)


def run(parsed: argparse.Namespace, console: Console) -> int:
    """Play policies on the same scenes, print their table, and write their episodes."""
    if parsed.out and parsed.out.is_dir():
        raise ConfigError(f"--out {parsed.out} is a folder; give the name of a file")
    if parsed.video:
        check_video(parsed.video, len(set(parsed.policies)))
    # All are made before the first plays: what is wrong with the last is then known at once.
    players = {name: _player(name, parsed) for name in parsed.policies}
    with ProgressReport(say(parsed), "evaluating") as report:
        played = _play_all(players, parsed, report)
    if parsed.out:
        parsed.out.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(parsed.out, episodes_as_csv(sum(played.values(), [])).encode())
    summaries = [summarise(episodes) for episodes in played.values()]
    if parsed.json:
        print_json([_as_numbers(summary) for summary in summaries])
    else:
        print_table(console, f"{parsed.split} scenes", HEADERS, summary_rows(summaries))
    if parsed.video:
        _film(list(players), parsed)
    return 0


def _film(names: list[str], parsed: argparse.Namespace) -> None:
    """Film the first scenes; those who play are made anew, so that they draw by chance what they drew before."""
    players = [Player(name, *_player(name, parsed)) for name in names]
    n_scenes = min(len(player.env.scenes) for player in players)
    record_video(players, parsed.video, [number % n_scenes for number in range(parsed.video_episodes)], parsed.seed)
    say(parsed).print(f"the film is {parsed.video}", highlight=False, soft_wrap=True)


def _player(name: str, parsed: argparse.Namespace) -> tuple[Policy, ResectEnv]:
    """Return a policy and the environment that it is to play."""
    home = home_of(name)
    env = ResectEnv(parsed.scene or home.scene, parsed.split, parsed.mask or home.mask)
    return make_policy(name, env, parsed.seed), env


def _play_all(
    players: dict[str, tuple[Policy, ResectEnv]], parsed: argparse.Namespace, report: ProgressReport
) -> dict[str, list[Episode]]:
    """Play every policy's scenes, and show after each episode how far it is and how it goes."""
    wanted = {name: parsed.episodes or len(env.scenes) for name, (_, env) in players.items()}
    total = sum(wanted.values())
    played: dict[str, list[Episode]] = {name: [] for name in players}

    def tell(episode: Episode) -> None:
        played[episode.policy].append(episode)
        mine = played[episode.policy]
        steps, seconds = sum(each.n_steps for each in mine), sum(each.seconds for each in mine)
        summary = summarise(mine)
        text = f"{steps / seconds:.0f} steps/s  return {summary.total_return.mean:.2f}  success {summary.success.mean:.2f}"
        report.update(sum(map(len, played.values())) / total, f"{episode.policy}  {text}")

    for name, (policy, env) in players.items():
        evaluate(policy, env, parsed.episodes, name=name, seed=parsed.seed, on_episode=tell)
    return played


def _as_numbers(summary: Summary) -> dict[str, object]:
    """Return a summary as names and numbers."""
    return {key: value._asdict() if isinstance(value, Estimate) else value for key, value in summary._asdict().items()}


COMMAND = Command(
    "play held-out scenes and print a table",
    "evaluate certificate --split test\n"
    "evaluate lookahead --scene box-108 --split test --episodes 16\n"
    "evaluate shield:rim-first foresight:100:rim-first search:100 --scene box-108\n"
    "evaluate rim-first shield:rim-first --scene box-192 --episodes 4 --video runs/two.gif\n"
    "evaluate runs/box-108/best.zip --out runs/box-108/test.csv",
    add_arguments,
    run,
)
