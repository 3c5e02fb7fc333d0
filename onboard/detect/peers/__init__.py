"""Published methods for comparison; nothing here is meant to fly."""
