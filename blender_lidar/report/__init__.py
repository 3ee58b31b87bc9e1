"""What a run or a study found, for people: figures, sentences, and a page to send to a colleague."""
