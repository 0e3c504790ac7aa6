"""`python -m gpf` is `gpf`."""

from gpf.cli import main

if __name__ == "__main__":
    main()
