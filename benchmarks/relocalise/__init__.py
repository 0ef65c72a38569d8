"""Where a robot is between walls: every observer, the search and particle filters on the same drives."""
