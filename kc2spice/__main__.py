"""Entry point of the program ``kc2spice``, also for ``python -m kc2spice``.

Signal handlers are installed first, because the modules of the command line load slowly.
"""

from kc2spice.core.interrupt import end_on_signals


def main() -> None:
    """Run the command line."""
    with end_on_signals():
        from kc2spice.cli.main import run_command_line as run

        run()


if __name__ == "__main__":
    main()
