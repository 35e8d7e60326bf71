# A page with the file `tables` between its lines <!-- NAME --> and <!-- /NAME -->, NAME being `name` or else tables; at its end
# where it has none.

function insert(   line) { print "<!-- " name " -->"; while ((getline line < tables) > 0) print line; print "<!-- /" name " -->"; done = 1 }
BEGIN { if (name == "") name = "tables" }
$0 == "<!-- " name " -->" { insert(); inside = 1; next }
$0 == "<!-- /" name " -->" { inside = 0; next }
!inside { print }
END { if (!done) insert() }
