"""What a run found, told to people: rows and sentences for the terminal, and a page to send to a colleague."""
