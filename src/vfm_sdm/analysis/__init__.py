"""What is concluded from displacement."""
