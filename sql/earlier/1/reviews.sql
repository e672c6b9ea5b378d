-- grain: a review
-- meaning: table reviews of schema version 1 with the columns of version 2
SELECT * RENAME (
    judged_class AS reviewed_class,
    judged_box_x_px AS reviewed_box_x_px,
    judged_box_y_px AS reviewed_box_y_px,
    judged_box_width_px AS reviewed_box_width_px,
    judged_box_height_px AS reviewed_box_height_px
)
FROM {earlier}
