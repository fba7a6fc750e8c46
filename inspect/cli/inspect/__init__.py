"""Commands that inspect parts and reopen inspection folders."""
