"""What leaves ground: TDM and OEM messages, tables with units."""
