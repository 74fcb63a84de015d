"""The blind benchmark: cases from the independent robot, sealed labels, answers, score. Page: docs/blind.md."""
