"""``python -m kc2spice`` is the ``kc2spice`` script."""

from kc2spice.cli.main import main

main()
