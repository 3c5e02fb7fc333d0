"""The contract between simulator, on-board software, ground software and harness.

Types, units, flags, codec numbers and the byte layout of packets; no physics. Everything here needs numpy
and the standard library only, and imports nothing else of the project. `ICD.md` in this folder defines every
field in words.

Conventions (stated once, used everywhere)
------------------------------------------
* Pixels are ``(row, col)``, 0-based; the centre of pixel (0, 0) is (0.0, 0.0). Arrays are indexed ``[row, col]``.
* Time is integer nanoseconds of TAI since 1958-01-01T00:00:00 TAI (``*_tai_ns``).
* Quaternions are scalar last and rotate *apparent* GCRS directions into the camera frame:
  +Z boresight, +X towards growing col, +Y towards growing row.
* Numbers carry their unit in their name; angles of sky positions are degrees, covariances of attitude rad^2.
"""
