"""The command line: ``python -m prgbd slam=orb_gtsam depth=monodepth2``; see ``python -m prgbd --help``."""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Sequence
from typing import TYPE_CHECKING

from prgbd.cli.arguments import is_multirun, is_true, normalise, value_of
from prgbd.core.errors import ConfigError, PrgbdError
from prgbd.io.command import complain, exit_code
from prgbd.version import __version__

if TYPE_CHECKING:
    from omegaconf import DictConfig

# What the run of this process failed with. Hydra would add lines of its own to an exception that passes through it.
_failures: list[Exception] = []


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        argv: Arguments without the program's name; ``sys.argv[1:]`` when None.

    Returns:
        The exit code, see ``ExitCode``.
    """
    # Threads that spin while they wait make everything ten times slower as soon as the machine has other work.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    arguments = list(sys.argv[1:] if argv is None else argv)
    debug = is_true(value_of(arguments, "debug")) or os.environ.get("HYDRA_FULL_ERROR") == "1"
    return exit_code(lambda: _main(arguments), debug=debug)


def _main(arguments: list[str]) -> int:
    if "--help" in arguments or "-h" in arguments:
        _help([argument for argument in arguments if argument not in ("--help", "-h")])
        return 0
    if "--version" in arguments:
        print(f"prgbd {__version__}")
        return 0
    normalised = normalise(arguments)
    for option in ("out", "resume"):
        if (found := value_of(normalised, option)) is not None and not found.strip("'\" "):
            raise ConfigError(f"{option}= is empty; name a folder, or leave it out.")
    resume_from = value_of(normalised, "resume")
    if resume_from is not None and resume_from.lower() not in ("null", "false", "no"):
        from prgbd.cli.resuming import resume

        resume(resume_from, normalised)
        return 0
    return _through_hydra(normalised)


def _help(arguments: list[str]) -> None:
    """Print the help, or that of the groups and options which are named."""
    from prgbd.cli.display import make_console
    from prgbd.cli.help import print_help

    names = [argument for argument in arguments if "=" not in argument and not argument.startswith("-")]
    if not names:
        print_help(make_console())
        return
    from prgbd.cli.option_help import print_option_help

    for name in names:
        print_option_help(make_console(), name)


def _through_hydra(arguments: list[str]) -> int:
    """Let Hydra compose the configuration and run the task, or several."""
    import hydra
    from hydra.errors import HydraException
    from omegaconf.errors import OmegaConfBaseException

    from prgbd.cli import sweep
    from prgbd.cli.hydra_bridge import register
    from prgbd.cli.hydra_errors import explain
    from prgbd.cli.run_folder import RunFolder

    register()
    run = hydra.main(version_base="1.3", config_path="pkg://prgbd.conf", config_name="prgbd")(_task)
    argv, full_error = sys.argv, os.environ.get("HYDRA_FULL_ERROR")
    _failures.clear()
    sys.argv = ["prgbd", *arguments]
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra shall hand its errors to us instead of printing them
    sweep.AblationTable.last_sweep = None
    try:
        run()
    except (HydraException, OmegaConfBaseException) as error:
        raise explain(error) from error
    except BrokenPipeError:
        raise
    except OSError as error:  # those of the runs are in _failures, so this one is Hydra's
        RunFolder.take_back()
        raise ConfigError(
            f"The run's folder {error.filename} cannot be made ({error.strerror}); choose another out=FOLDER."
        ) from error
    finally:
        sys.argv = argv
        os.environ.pop("HYDRA_FULL_ERROR")
        if full_error is not None:
            os.environ["HYDRA_FULL_ERROR"] = full_error
    if _failures:
        raise _failures[0]
    return sweep.exit_code(sweep.AblationTable.last_sweep) if is_multirun(arguments) else 0


def _task(config: DictConfig) -> None:
    """One run, as Hydra calls it."""
    from pathlib import Path

    from hydra.core.hydra_config import HydraConfig
    from hydra.types import RunMode
    from omegaconf import OmegaConf

    from prgbd.cli import job, sweep

    plain = OmegaConf.to_container(config, resolve=True)
    assert isinstance(plain, dict)
    context = HydraConfig.get()
    folder = Path(context.runtime.output_dir)
    overrides = [str(override) for override in context.overrides.task]
    choices = {str(group): choice for group, choice in context.runtime.choices.items() if "/" not in str(group)}
    options = {str(key): value for key, value in plain.items()}
    if context.mode != RunMode.MULTIRUN:
        try:
            job.start(options, folder, overrides, choices)
        except Exception as error:
            _failures.append(error)
        return
    sweep.forget_failure(folder)
    try:
        if job.holds_same_run(folder, options):
            job.resume(folder, {})
        else:
            job.start(options, folder, overrides, choices)
    except BrokenPipeError:
        raise
    except PrgbdError as error:
        complain(f"run {folder.name}: {error}")
        sweep.note_failure(folder, error)
    except Exception as error:
        traceback.print_exc()
        sweep.note_failure(folder, error)


if __name__ == "__main__":
    raise SystemExit(main())
