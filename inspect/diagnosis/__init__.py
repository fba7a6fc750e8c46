"""What is wrong with a part: causes, what each would change, and which of them explains what was seen."""
