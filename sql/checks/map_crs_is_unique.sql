-- table: georeference
-- grain: campaign
-- meaning: building and georeference name the same map CRS and vertical datum
SELECT b.map_crs, g.map_crs AS georeference_map_crs, b.vertical_datum, g.vertical_datum AS georeference_vertical_datum
FROM buildings AS b, georeference AS g
WHERE b.map_crs <> g.map_crs OR b.vertical_datum <> g.vertical_datum
