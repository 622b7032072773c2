"""What people and machines are told: a page, JUnit, lines in a terminal."""
