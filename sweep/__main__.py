"""``python -m sweep`` is ``sweep``."""

from .cli import main

if __name__ == "__main__":
    main()
