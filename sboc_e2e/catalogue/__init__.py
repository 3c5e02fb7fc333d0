"""Star catalogue: Tycho-2 to V < 11 embedded, deeper ones from files, cone searches with proper motion applied.

Positions are ICRS; `StarCatalogue.cone` returns them at the epoch asked for, with the error the catalogue quotes there.
"""

from sboc_e2e.catalogue.catalogue import StarCatalogue
from sboc_e2e.catalogue.stars import CatalogueFlag, Stars

__all__ = ["CatalogueFlag", "StarCatalogue", "Stars"]
