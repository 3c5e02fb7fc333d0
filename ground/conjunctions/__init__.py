"""Close approaches of known objects: who meets whom, how likely they touch, and the messages that say so. GCRS axes, km, s."""
