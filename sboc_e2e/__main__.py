"""Entry point of `sboc` and of ``python -m sboc_e2e``: names no library, so that an interrupt while they load is one line too."""

import sys


def main() -> None:
    """Load the command line and run it."""
    try:
        from sboc_e2e.cli import main as command_line
    except KeyboardInterrupt:
        if sys.stderr is not None:  # None: the caller has closed it
            sys.stderr.write("sboc: interrupted before anything was done\n")
        sys.exit(2)
    command_line()


if __name__ == "__main__":
    main()
