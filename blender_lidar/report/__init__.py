"""What a run or a study found, told to people: figures, sentences, and a page to send to a colleague."""
