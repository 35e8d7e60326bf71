# A page with the file `tables` between its lines <!-- tables --> and <!-- /tables -->; at its end where it has none.

function insert(   line) { print "<!-- tables -->"; while ((getline line < tables) > 0) print line; print "<!-- /tables -->"; done = 1 }
/^<!-- tables -->$/ { insert(); inside = 1; next }
/^<!-- \/tables -->$/ { inside = 0; next }
!inside { print }
END { if (!done) insert() }
