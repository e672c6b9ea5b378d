"""What a detector learns from and is judged by: pictures with boxes, split by site, and pictures without any."""
