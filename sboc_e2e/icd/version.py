"""Version of the contract, stamped into every packet and product, with its history."""

from typing import Final

CONTRACT_MAJOR: Final = 1
CONTRACT_MINOR: Final = 0
CONTRACT_VERSION: Final = f"{CONTRACT_MAJOR}.{CONTRACT_MINOR}"

HISTORY: Final = (("1.0", "first contract: frames, packets, products, steps, flags"),)
