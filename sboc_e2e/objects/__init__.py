"""The object catalogue as a user meets it: files in, the ground segment's answers out, pages and messages written."""
