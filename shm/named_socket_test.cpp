#include "shm/named_socket.h"

#include <gtest/gtest.h>
#include <poll.h>
#include <unistd.h>

#include <algorithm>

namespace fr::shm {
namespace {

std::string freshName(const char* what) { return fmt::format("test-{}-{}", what, ::getpid()); }

TEST(NamedSocket, NamesAreChecked) {
  for (const char* good : {"a", "frame.3", "A_b-9"}) EXPECT_TRUE(isSocketName(good)) << good;
  for (const char* bad : {"", "a b", "../x", "a/b", "\xff"}) EXPECT_FALSE(isSocketName(bad)) << bad;
  EXPECT_FALSE(isSocketName(std::string(65, 'a')));
  EXPECT_FALSE(isSocketName(std::string_view("a\0b", 3)));
  auto listener = NamedListener::listen("no/name");
  ASSERT_FALSE(listener);
  EXPECT_EQ(listener.error().code, RiError::kRange);
}

TEST(NamedSocket, BothEndsMeetAndTalk) {
  const std::string name = freshName("meet");
  auto listener = NamedListener::listen(name);
  ASSERT_TRUE(listener) << listener.error().str();
  auto nobody = listener->accept();
  ASSERT_TRUE(nobody);
  EXPECT_FALSE(*nobody);
  auto client = connectNamed(name);
  ASSERT_TRUE(client) << client.error().str();
  EXPECT_EQ(peerProcessId(*client), ::getpid());
  auto server = listener->accept();
  ASSERT_TRUE(server && *server);
  EXPECT_EQ(peerProcessId(**server), ::getpid());
  const std::byte word[3] = {std::byte{1}, std::byte{2}, std::byte{3}};
  ASSERT_TRUE(client->send(word, {}));
  auto got = (*server)->receive(std::chrono::seconds(10));
  ASSERT_TRUE(got && *got);
  EXPECT_EQ((*got)->bytes.size(), 3u);
  client->close();
  EXPECT_FALSE((*server)->alive());
}

TEST(NamedSocket, ANameIsTakenOnceAndFreeAgainAfterwards) {
  const std::string name = freshName("once");
  {
    auto first = NamedListener::listen(name);
    ASSERT_TRUE(first);
    const auto names = listSocketNames();
    EXPECT_EQ(std::count(names.begin(), names.end(), name), 1);
    auto second = NamedListener::listen(name);
    ASSERT_FALSE(second);
    EXPECT_EQ(second.error().code, RiError::kIllState);
    EXPECT_NE(second.error().message.find(name), std::string::npos);
  }
  auto nobody = connectNamed(name);
  ASSERT_FALSE(nobody);
  EXPECT_EQ(nobody.error().code, RiError::kNoFile);
  const auto names = listSocketNames();
  EXPECT_EQ(std::count(names.begin(), names.end(), name), 0);
  EXPECT_TRUE(NamedListener::listen(name));
}

}  // namespace
}  // namespace fr::shm
