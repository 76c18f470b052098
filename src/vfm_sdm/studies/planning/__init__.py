"""Rehearsal of a site before anybody drives there: what a set-up will be worth, and what would make it better."""
