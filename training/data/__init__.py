"""What a detector learns from and is judged by: real pictures with boxes, split by site, and pictures without defects."""
