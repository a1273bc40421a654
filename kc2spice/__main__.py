"""Entry point of the program ``kc2spice``, also for ``python -m kc2spice``.

The signal handlers are installed before the slow import of the command-line modules, so that Ctrl-C
also works during this import.
"""

from kc2spice.core.signal_handlers import end_on_signals


def main() -> None:
    """Run the program ``kc2spice`` with the arguments of the command line."""
    with end_on_signals():
        from kc2spice.cli.main import run_command_line as run

        run()


if __name__ == "__main__":
    main()
