"""The ``kc2spice`` script, also as ``python -m kc2spice``.

Signals are handled before the modules of the command line are loaded, which takes a while.
"""

from kc2spice.core.interrupt import end_on_signals


def main() -> None:
    """Run the command line."""
    with end_on_signals():
        from kc2spice.cli.main import run_command_line as run

        run()


if __name__ == "__main__":
    main()
