"""Where to point and when: targets, constraints and the worth of a visit become a schedule.

options      what the plan asks for: horizon, visits, constraints, worth
sky          Sun, Moon, Earth and the station at the instants of the plan
targets      catalogue objects and their directions
constraints  which target may be seen at which instant, and what forbids it where it may not
contradiction  which constraints leave nothing
windows      when each target can be seen, to half a second
light        magnitude and accuracy of a target in one visit
worth        what is known of each orbit, and what a visit adds to it
greedy       the schedule, one visit after another, with look-ahead
fence        fields that scan a strip of the sky so that nothing slips through
schedule     the result
prm          the result as a CCSDS Pointing Request Message
"""
