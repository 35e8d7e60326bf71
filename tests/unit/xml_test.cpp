// Places in a text, the messages that quote them, and substitution of $names.

#include "stages/core/description/xml_document.h"
#include "tests/unit/scene_folder.h"

namespace loom {
namespace {

class Xml : public SceneFolder {};

TEST_F(Xml, PlacesOfElementsAndAttributes) {
    // A byte order mark, CRLF and tabs must not move the places that messages name.
    const auto file = write("a.xml", "\xEF\xBB\xBF<scene>\r\n\t<float  name = 'alpha'\r\n value=\"1>2\"/>\r\n</scene>");
    const XmlDocument document(file, "a.xml");
    const pugi::xml_node node = document.root().child("float");
    EXPECT_EQ(document.at(node).where(), "a.xml:2:2");
    EXPECT_EQ(document.at(node, "name").where(), "a.xml:2:18");
    EXPECT_EQ(document.at(node, "value").where(), "a.xml:3:9");
    EXPECT_EQ(document.at(node, "absent").where(), "a.xml:2:2");
    EXPECT_EQ(locate(document.at(node, "name"), "what"),
              "a.xml:2:18: what\n  \t<float  name = 'alpha'\n  \t                ^");
}

TEST_F(Xml, MalformedXmlNamesThePlace) {
    const auto file = write("a.xml", "<scene>\n  <float>\n</scene>");
    const std::string message = error_of([&] { XmlDocument(file, "a.xml"); });
    EXPECT_TRUE(message.starts_with("a.xml:3:")) << message;
    EXPECT_NE(message.find("malformed XML"), std::string::npos) << message;
    EXPECT_NE(message.find("\n  </scene>\n"), std::string::npos) << message;
    EXPECT_EQ(error_of([&] { XmlDocument(path("none.xml"), "none.xml"); }), "none.xml: no such file");
}

TEST_F(Xml, LongLinesAreCutAroundTheCaret) {
    const auto source = std::make_shared<const SourceText>(SourceText{"a", std::string(5000, 'x')});
    EXPECT_LT(locate({source, 2500}, "m").size(), 400u);
}

TEST_F(Xml, NearestNamesComeFirst) {
    EXPECT_EQ(nearest_first("intIOR", {"alpha", "ext_ior", "int_ior"}), "int_ior, ext_ior, alpha");
    EXPECT_EQ(nearest_first("reflectence", {"alpha", "reflectance"}), "reflectance, alpha");
    EXPECT_EQ(nearest_first("x", {}), "none");
}

TEST_F(Xml, Substitution) {
    Substitutions s({{"spp", "4"}, {"spp", "8"}});
    s.set_default("spp", "1");
    s.set_default("res", "64");
    s.set_default("res", "128");
    s.set_default("unused", "0");
    EXPECT_EQ(s.apply("a$spp/$res.", {}), "a8/64.");  // the last -D, the first default
    EXPECT_NO_THROW(s.check_all_used());
    EXPECT_EQ(s.used().size(), 2u);
    EXPECT_THROW(s.apply("$spp2", {}), InputError);
}

}  // namespace
}  // namespace loom
