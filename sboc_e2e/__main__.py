"""``python -m sboc_e2e`` is ``sboc``."""

from sboc_e2e.cli import main

if __name__ == "__main__":
    main()
