"""``python -m prgbd.tools``: what is beside the loop; ``python -m prgbd.tools COMMAND --help`` says more of each."""

from __future__ import annotations

import argparse
from pathlib import Path

from prgbd.io.command import exit_code


def main(argv: list[str] | None = None) -> int:
    """Run one of the tools.

    Args:
        argv: Arguments; ``sys.argv`` when None.

    Returns:
        The exit code: 0, 1 if something that is needed is missing, 2 for a wrong argument.
    """
    parser = _parser()
    arguments = parser.parse_args(argv)
    if arguments.command is None:
        parser.print_help()
        return 2
    return exit_code(lambda: _run(arguments))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m prgbd.tools", description="What is beside the loop.")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    commands.add_parser("doctor", help="what is installed, what the machine has, and what is missing")
    prepare = commands.add_parser("prepare", help="what to download of a data set, and what of it lies in a folder")
    prepare.add_argument("name", help="id of the data set, such as kitti_odometry")
    prepare.add_argument("folder", nargs="?", type=Path, help="where it lies, as in data.root=FOLDER")
    calibrate = commands.add_parser("calibrate", help="the camera of a video or a folder of images, by COLMAP")
    calibrate.add_argument("recording", type=Path, help="the video or the folder of images")
    calibrate.add_argument("--out", metavar="FILE", help="the camera file; by default beside the recording")
    board = commands.add_parser("leaderboard", help="a run's trajectories as the KITTI odometry benchmark takes them")
    board.add_argument("run", type=Path, help="the folder of the run")
    board.add_argument("folder", nargs="?", type=Path, help="where the files go; by default RUN/leaderboard")
    board.add_argument(
        "--scale",
        metavar="FACTOR",
        default="1",
        help="on translations; truth takes the factor found on the run's recordings with true poses",
    )
    return parser


def _run(arguments: argparse.Namespace) -> int:
    if arguments.command == "doctor":
        from prgbd.tools import doctor

        return doctor.main()
    if arguments.command == "prepare":
        from prgbd.tools.download_guides import prepare

        return prepare(arguments.name, None if arguments.folder is None else arguments.folder.expanduser())
    if arguments.command == "calibrate":
        from prgbd.tools.calibrate import calibrate

        return calibrate(arguments.recording.expanduser(), arguments.out)
    from prgbd.tools.leaderboard import leaderboard

    folder = None if arguments.folder is None else arguments.folder.expanduser()
    return leaderboard(arguments.run.expanduser(), folder, arguments.scale)


if __name__ == "__main__":
    raise SystemExit(main())
