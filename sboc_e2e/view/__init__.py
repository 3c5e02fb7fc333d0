"""`sboc view`: frames of a run in the tools that people have: DS9 regions, VOTables, SAMP, a page in the browser."""

from sboc_e2e.view.files import write_files
from sboc_e2e.view.page import write_page
from sboc_e2e.view.run_frames import RunFrames
from sboc_e2e.view.samp import Hub, send

__all__ = ["Hub", "RunFrames", "send", "write_files", "write_page"]
